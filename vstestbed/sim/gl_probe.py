"""Which OpenGL backend works, found out before MuJoCo and dm_control are imported: they choose
theirs at import.
"""

from __future__ import annotations

import ctypes
import os
import platform
import sys
from typing import Any

from vstestbed.core.errors import EnvironmentLackError

INSTALL = {
    "debian": "apt-get install libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri",
    "fedora": "dnf install mesa-libEGL mesa-libGL mesa-dri-drivers",
    "rhel": "dnf install mesa-libEGL mesa-libGL mesa-dri-drivers",
    "arch": "pacman -S libglvnd mesa",
    "suse": "zypper install libglvnd Mesa-libEGL1 Mesa-libGL1 Mesa-dri",
}
"""The command that installs EGL, OpenGL and Mesa's drivers, by the word in /etc/os-release (ID or
ID_LIKE).
"""
RAYS_INSTEAD = "rays draw the pictures instead, without shadows"
UNSET_REMEDY = "unset MUJOCO_GL or set MUJOCO_GL=egl"
LIBRARIES = {
    "egl": ("libEGL.so.1", "libGL.so.1"),
    "osmesa": ("libOSMesa.so.8",),
    "glfw": ("libGL.so.1",),
}
"""Shared libraries that each of MuJoCo's backends loads, by its name in MUJOCO_GL."""
DEVICE_PLATFORM = 0x313F  # EGL_PLATFORM_DEVICE_EXT, from the extension EGL_EXT_platform_device
DEVICE = "MUJOCO_EGL_DEVICE_ID"  # the variable that names one of EGL's devices, a GPU of several
ON = "", "1", "on", "true", "enable", "enabled"
OFF = "0", "off", "false", "disable", "disabled"
# why OpenGL is switched off, as (lack, remedy); empty where it is not
_lack: list[tuple[str, str]] = []


def remedy() -> str:
    """The command that installs OpenGL on this distribution, as root;
    Debian's on an unknown one.
    """
    try:
        release = platform.freedesktop_os_release()
    except OSError:  # not Linux, or a bare container
        release = {}
    words = f"{release.get('ID', '')} {release.get('ID_LIKE', '')}"
    words = words.replace("opensuse", "suse").replace("ubuntu", "debian")
    known = [word for word in words.split() if word in INSTALL]
    command = INSTALL[known[0]] if known else f"(on Debian or Ubuntu) {INSTALL['debian']}"
    return f"as root: {command}; then `vstestbed doctor` tells whether it works"


def switch_off(lack: str, remedy: str) -> None:
    """Refuse OpenGL from now on, in this process."""
    _lack.insert(0, (lack, remedy))


def missing_libraries(backend: str = "egl") -> list[str]:
    """Shared libraries that a backend needs and the dynamic loader does not find."""
    missing = []
    for name in LIBRARIES[backend]:
        try:
            ctypes.CDLL(name)
        except OSError:
            missing.append(name)
    return missing


def _taken(devices: list[int]) -> list[int]:
    """The devices of EGL that may be taken: one that DEVICE names, else all. ValueError: it names
    none.
    """
    given = os.environ.get(DEVICE)
    if given is None:
        return devices
    if not given.isdecimal() or int(given) >= len(devices):
        raise ValueError(f"{DEVICE}={given} is set, and the devices are 0 to {len(devices) - 1}")
    return [devices[int(given)]]


def _egl_lack() -> tuple[str, str] | None:
    """Why none of the EGL devices that may be taken initialises a display, and the remedy; None
    where one does. A first start takes 25 ms.

    MuJoCo and dm_control make the same calls when they are imported. They are made here with ctypes
    alone, because importing PyOpenGL would fix its platform.
    """
    egl = ctypes.CDLL("libEGL.so.1")
    pointer = ctypes.c_void_p
    number = ctypes.c_int
    egl.eglGetProcAddress.restype = pointer
    egl.eglGetProcAddress.argtypes = [ctypes.c_char_p]
    egl.eglInitialize.argtypes = [pointer, pointer, pointer]
    address = [
        egl.eglGetProcAddress(name) for name in (b"eglQueryDevicesEXT", b"eglGetPlatformDisplayEXT")
    ]
    none = "libEGL starts no display", remedy()
    if not all(address):
        return none
    query = ctypes.CFUNCTYPE(ctypes.c_uint, number, pointer, pointer)(address[0])
    display_of = ctypes.CFUNCTYPE(pointer, ctypes.c_uint, pointer, pointer)(address[1])
    devices = (pointer * 16)()
    count = number()
    if not query(16, devices, ctypes.byref(count)):
        return none
    try:
        taken = _taken(devices[: count.value])
    except ValueError as error:
        return str(error), f"unset {DEVICE}"
    displays = [display_of(DEVICE_PLATFORM, device, None) for device in taken]
    starts = any(display and egl.eglInitialize(display, None, None) for display in displays)
    return None if starts else none


def choose_backend() -> None:
    """Set MUJOCO_GL on Linux: `egl` where it is unset, `disable` where the backend that it names
    cannot work.

    MuJoCo and dm_control load their backend at import and fail with an obscure error where it is
    missing.
    """
    if not sys.platform.startswith("linux"):
        return
    word = os.environ.get("MUJOCO_GL", "").strip().lower()
    backend = word
    if word in ON:
        backend = "egl"
    elif word in OFF:
        backend = "disable"
    if backend != "disable" and (lack := _lack_of(backend, requested=word not in ON)):
        _lack.append(lack)
        backend = "disable"
    os.environ["MUJOCO_GL"] = backend
    if backend in ("egl", "osmesa"):
        os.environ["PYOPENGL_PLATFORM"] = backend


def _lack_of(backend: str, requested: bool) -> tuple[str, str] | None:
    """Why a backend cannot work, and the remedy; None where it can. `requested`: the user named it
    in MUJOCO_GL.
    """
    if backend not in LIBRARIES:
        return (
            f"MUJOCO_GL={backend} is set, and there is no such backend",
            f"unset MUJOCO_GL, or set it to {', '.join(sorted(LIBRARIES))}",
        )
    if missing := missing_libraries(backend):
        lack = f"{' and '.join(missing)} not found"
        if not requested:
            return lack, remedy()
        way = remedy() if backend == "egl" else UNSET_REMEDY
        return f"{lack}, which MUJOCO_GL={backend} needs", way
    if backend == "egl" and (lack := _egl_lack()) is not None:
        return lack
    shown = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if backend == "glfw" and not shown:
        return "MUJOCO_GL=glfw needs a display, and there is none", UNSET_REMEDY
    return None


def require() -> None:
    """Raise EnvironmentLackError, with the remedy, where OpenGL is switched off."""
    word = os.environ.get("MUJOCO_GL", "")
    if _lack:
        lack, way = _lack[0]
    elif word.lower() not in OFF:
        return
    elif missing := missing_libraries():
        # the user switched it off, or a parent process did and MUJOCO_GL was inherited
        lack = f"{' and '.join(missing)} not found"
        way = remedy()
    else:
        lack = f"MUJOCO_GL={word} is set"
        way = UNSET_REMEDY
    raise EnvironmentLackError(f"no OpenGL: {lack}", way)


def explain(error: ImportError) -> EnvironmentLackError | None:
    """The error to show for a failed import of MuJoCo's or dm_control's renderer; None where EGL is
    not the cause.
    """
    words = str(error).rstrip(".")
    return EnvironmentLackError(f"no OpenGL: {words}", remedy()) if "EGL" in words else None


def renderer_string() -> str:
    """GL_RENDERER of the current context, such as `llvmpipe (LLVM 15.0.6, 256 bits)`."""
    # comes with dm_control; not OpenGL.GL, which imports all extensions in .06 s
    from OpenGL.raw.GL.VERSION import GL_1_0

    text: Any = GL_1_0.glGetString(GL_1_0.GL_RENDERER)
    value = ctypes.cast(text, ctypes.c_char_p).value
    return value.decode() if value else "unknown"
