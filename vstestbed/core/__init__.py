"""What every room may use: frames and twists, the plane, specs, errors, files."""
