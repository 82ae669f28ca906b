"""Simulation, the only folder that imports mujoco and dm_control: scenes, rendering, physics, the
ideal camera, timing.
"""

from vstestbed.robots.chain import READERS, ChainReader
from vstestbed.sim import gl_probe as _gl

# before the first import of mujoco anywhere: both libraries read MUJOCO_GL when imported
_gl.choose_backend()


def _reader() -> ChainReader:
    from vstestbed.sim.scene import joint_chain  # here: it imports mujoco

    return joint_chain


READERS.append(_reader)
