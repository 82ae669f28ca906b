"""Simulation, the only folder that imports mujoco and dm_control: scenes, rendering, physics, the ideal camera, timing."""

from vstestbed.sim.render import gl_probe as _gl

_gl.choose_backend()  # before the first import of mujoco anywhere: both libraries read MUJOCO_GL when imported
