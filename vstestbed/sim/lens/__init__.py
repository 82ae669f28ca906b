"""How MuJoCo pictures become those of a lens: pinhole faces of a cube, remapped."""
