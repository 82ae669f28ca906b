"""What all tests share: which OpenGL, and that nothing is written beside the tests."""

import vstestbed.sim  # noqa: F401 - chooses MUJOCO_GL before any test imports mujoco
