"""Pictures: by OpenGL or by rays, exposure, noise, windows."""
