"""How the textures are drawn: colours (H, W, 3) in 0..1, red first, by numpy and OpenCV from a
seed.
"""
