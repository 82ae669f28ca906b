"""The scene: robot, camera, target and world composed into one MuJoCo model."""
