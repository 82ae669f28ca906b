"""Which OpenGL there is, found before MuJoCo and dm_control are imported (they decide at import, and die badly)."""

from __future__ import annotations

import ctypes
import os
import sys

from vstestbed.errors import EnvironmentLackError

REMEDY = "on Debian or Ubuntu: apt-get install libegl1 libgl1 (then `vstestbed doctor` tells whether it works)"


def missing_libraries() -> list[str]:
    """Shared libraries that offscreen OpenGL needs and the loader does not find."""
    missing = []
    for name in ("libEGL.so.1", "libGL.so.1"):
        try:
            ctypes.CDLL(name)
        except OSError:
            missing.append(name)
    return missing


def choose_backend() -> None:
    """Set MUJOCO_GL where the user set nothing: `egl` on Linux if its libraries are there, else `disable`."""
    if sys.platform.startswith("linux") and not os.environ.get("MUJOCO_GL"):
        os.environ["MUJOCO_GL"] = "disable" if missing_libraries() else "egl"
        if os.environ["MUJOCO_GL"] == "egl":
            os.environ.setdefault("PYOPENGL_PLATFORM", "egl")


def require() -> None:
    """Raise EnvironmentLackError, with the remedy, where no picture can be rendered."""
    if os.environ.get("MUJOCO_GL") in ("disable", "disabled", "off", "false", "0"):
        lacking = missing_libraries()
        found = f"{' and '.join(lacking)} not found" if lacking else f"MUJOCO_GL={os.environ['MUJOCO_GL']} is set"
        raise EnvironmentLackError(f"no OpenGL: {found}", REMEDY if lacking else "unset MUJOCO_GL or set MUJOCO_GL=egl")


def renderer_string() -> str:
    """GL_RENDERER of the current context, such as `llvmpipe (LLVM 15.0.6, 256 bits)`."""
    from OpenGL import GL  # comes with dm_control

    value = GL.glGetString(GL.GL_RENDERER)
    return value.decode() if value else "unknown"
