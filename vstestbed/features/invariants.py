"""Functions of a shape's moments that do not change with its place, size and rotation in the image."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from vstestbed.features.image_moments import MomentSet
from vstestbed.features.rated import Rated, square

Invariant = Callable[[MomentSet], Any]


def over(a: Any, b: Any) -> Any:
    """The ratio a/b, and 0/0 as a finite number: of a shape whose moments vanish by symmetry."""
    below = b.value if isinstance(b, Rated) else b
    return a / (b + np.where(below == 0, np.finfo(float).tiny, 0.0))


def c1(m: MomentSet) -> Any:
    """The row c1 = (mu11^2 - mu20 mu02) / |c20|^2."""
    return over(0.25 * (square(m.complex(2, 0)) - square(m.complex(1, 1))), square(m.complex(2, 0)))


def c2(m: MomentSet) -> Any:
    """The row c2 = |c30|^2 / |c21|^2."""
    return over(square(m.complex(3, 0)), square(m.complex(2, 1)))


def _third(m: MomentSet) -> tuple[Any, Any, Any, Any]:
    """|c30|^2, |c21|^2, c30 conj(c21)^3, and the denominator (|c30|^2 + 3 |c21|^2)^2 - 16 Re(c30 conj(c21)^3)."""
    c30, c21 = m.complex(3, 0), m.complex(2, 1)
    a, b, z = square(c30), square(c21), c30 * (c21 * c21 * c21).conj()
    return a, b, z, (a + 3 * b) ** 2 - 16 * z.real


def c3(m: MomentSet) -> Any:
    """The row c3 = (a^2 - 6 a b - 3 b^2 + 8 Re z) / D, with a = |c30|^2, b = |c21|^2, z = c30 conj(c21)^3, D = (a + 3 b)^2 - 16 Re z."""
    a, b, z, below = _third(m)
    return over(a * a - 6 * a * b - 3 * b * b + 8 * z.real, below)


def c4(m: MomentSet) -> Any:
    """The row c4 = 16 Im z / D, with z and D as in c3."""
    _, _, z, below = _third(m)
    return over(16 * z.imag, below)


def c5(m: MomentSet) -> Any:
    """The row c5 = (b - a) (a - 9 b) / D, with a, b and D as in c3."""
    a, b, _, below = _third(m)
    return over((b - a) * (a - 9 * b), below)


def c6(m: MomentSet) -> Any:
    """The row c6 = (a - 9 b)^2 / D, with a, b and D as in c3."""
    a, b, _, below = _third(m)
    return over((a - 9 * b) ** 2, below)


def _fourth(m: MomentSet) -> tuple[Any, Any, Any, Any]:
    """|c40|^2, |c31|^2, |c22|^2, and the denominator |c40|^2 - 4 |c31|^2 + 3 |c22|^2."""
    a, b, c = (square(m.complex(4 - i, i)) for i in range(3))
    return a, b, c, a - 4 * b + 3 * c


def c7(m: MomentSet) -> Any:
    """The row c7 = (|c40|^2 + 8 |c31|^2 - 9 |c22|^2) / (|c40|^2 - 4 |c31|^2 + 3 |c22|^2)."""
    a, b, c, below = _fourth(m)
    return over(a + 8 * b - 9 * c, below)


def c8(m: MomentSet) -> Any:
    """The row c8 = 4 (9 |c22|^2 + 4 |c31|^2 - |c40|^2) / (|c40|^2 - 4 |c31|^2 + 3 |c22|^2)."""
    a, b, c, below = _fourth(m)
    return over(4 * (9 * c + 4 * b - a), below)


def c9(m: MomentSet) -> Any:
    """The row c9 = |c32|^2 / |c50|^2."""
    return over(square(m.complex(3, 2)), square(m.complex(5, 0)))


def c10(m: MomentSet) -> Any:
    """The row c10 = |c41|^2 / |c50|^2."""
    return over(square(m.complex(4, 1)), square(m.complex(5, 0)))


def _s(m: MomentSet) -> Any:
    c20 = m.complex(2, 0)
    return over(1j * m.complex(3, 0) * (c20 * c20).conj() * m.area**0.5, square(c20) * m.complex(1, 1).real ** 1.5)


def sx(m: MomentSet) -> Any:
    """The row sx = Re S, S = i c30 conj(c20)^2 sqrt(a) / (|c20|^2 c11^(3/2)); S is 0 for a symmetric shape, and its rate is not."""
    return _s(m).real


def sy(m: MomentSet) -> Any:
    """The row sy = Im S, with S as in sx."""
    return _s(m).imag


def px(m: MomentSet) -> Any:
    """The row px = |c20|^2 / c11^2."""
    return over(square(m.complex(2, 0)), square(m.complex(1, 1)))


def py(m: MomentSet) -> Any:
    """The row py = a |c30|^2 / c11^3."""
    return over(m.area * square(m.complex(3, 0)), m.complex(1, 1).real ** 3)


INVARIANTS: dict[str, tuple[Invariant, int]] = {
    "c1": (c1, 2),
    "c2": (c2, 3),
    "c3": (c3, 3),
    "c4": (c4, 3),
    "c5": (c5, 3),
    "c6": (c6, 3),
    "c7": (c7, 4),
    "c8": (c8, 4),
    "c9": (c9, 5),
    "c10": (c10, 5),
    "sx": (sx, 3),
    "sy": (sy, 3),
    "px": (px, 2),
    "py": (py, 3),
}
"""By word, the function and the highest order of the moments in it.

c1 to c10: Chaumette 2004, doi:10.1109/TRO.2004.829463; sx, sy, px, py: Tahri & Chaumette 2005, doi:10.1109/TRO.2005.853500; here
written in complex moments, in which an invariance is seen at once: the turns of the factors cancel.
"""
