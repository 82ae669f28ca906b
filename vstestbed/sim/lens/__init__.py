"""Images of any lens, remapped from pinhole images of MuJoCo on the faces of a cube."""
