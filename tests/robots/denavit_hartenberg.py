"""The Puma's standard Denavit-Hartenberg frames: A_i = Rz(q_i) Tz(d_i) Tx(a_i) Rx(alpha_i),
T_base_flange = A_1 ... A_6.
"""

import numpy as np

from docs.build.parameters import PUMA_DH as DH
from vstestbed.core.geometry import Array


def frames(q: Array) -> Array:
    """T_base_i of the frames 0 to 6, shape (7, 4, 4), at joint angles (6,) [rad]."""
    found = [np.eye(4)]
    for theta, (d, a, alpha) in zip(q, DH, strict=True):
        # Exactly 0 or +-1, as every alpha is a multiple of a quarter turn; cos(pi / 2) alone is
        # 6e-17 in floating point.
        c, s, ca, sa = (
            np.cos(theta),
            np.sin(theta),
            np.round(np.cos(alpha)),
            np.round(np.sin(alpha)),
        )
        A = np.array(
            [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        )
        found.append(found[-1] @ A)
    return np.array(found)
