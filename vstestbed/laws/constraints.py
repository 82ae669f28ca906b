"""Quadratic programs of a law, and their constraints: joint limits, the picture's border, the
target's plane, limits of twists.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from vstestbed.camera.base import pixel_interaction
from vstestbed.core.geometry import Array, all_finite
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, TwistLimits
from vstestbed.laws.points import inputs_in_space, points, usable_rows
from vstestbed.laws.solve import least_squares
from vstestbed.robots.arm import unit_scale
from vstestbed.robots.own_model import OwnModel

# Most iterations of one program. A count and not a time: the same run gives the same commands on
# every machine.
ITERATIONS = 500
# exit codes of the solver: solved, and solved with soft constraints violated
SOLVED = 1, 2
INFEASIBLE = -1
SOFT = 8  # the solver's mark of a soft constraint
NOT_SOLVED = "the quadratic program was not solved"


@dataclass(frozen=True, slots=True)
class Group:
    """Inequalities low <= A x that give way together: their word, A (m, n) and low (m,)."""

    word: str
    A: Array
    low: Array

    def __len__(self) -> int:
        return len(self.A)

    @classmethod
    def none(cls, word: str, n: int) -> Group:
        """No inequalities of n unknowns."""
        return cls(word, np.zeros((0, n)), np.zeros(0))

    @classmethod
    def finite(cls, word: str, A: Array, low: Array) -> Group:
        """Those of the inequalities whose low is finite: others bound nothing."""
        known = np.isfinite(low)
        return cls(word, A[known], low[known])


@dataclass(frozen=True, slots=True)
class Solution:
    """What a program gave.

    Attributes:
        x: (n,); None where it could not be solved.
        gave_way: words of the groups that had to, the softest first.
        bound: whether a bound or an inequality is met with equality.
        failure: the solver's exit code in words; "" where it solved.
    """

    x: Array | None
    gave_way: tuple[str, ...] = ()
    bound: bool = False
    failure: str = ""

    def command(
        self, robot: OwnModel, basis: Array, limits: TwistLimits, words: tuple[str, ...]
    ) -> Command:
        """The command that orders the robot's velocities, which the solution begins with; rest
        where the program was not solved.

        words: of the groups in the order in which they give way. The mode is 0 where nothing binds,
        1 where a constraint binds, 2 and more for the last group that gave way (`program_modes`).
        """
        if self.x is None:
            return replace(Command.rest(basis, self.failure), mode=2 + len(words))
        mode = 2 + words.index(self.gave_way[-1]) if self.gave_way else int(self.bound)
        rates = self.x[: len(robot.names)]
        twist = robot.J @ rates
        scale = limits.scale(twist)
        rates = rates * scale
        twist = twist * scale
        u = twist if basis.shape == (6, 6) else least_squares(basis, twist)
        return Command(u, twist, scale=scale, rates=rates, mode=mode)

    def and_accelerations(self, too_quick: bool) -> Solution:
        """The same; where too_quick, the accelerations had to give way to positions and speeds
        (`velocity_bounds`).
        """
        if not too_quick or "acceleration" in self.gave_way:
            return self
        return replace(self, gave_way=(*self.gave_way, "acceleration"))


def program_modes(words: tuple[str, ...]) -> tuple[str, ...]:
    """Words for `Law.modes` of a law whose groups of constraints give way in the order of `words`;
    the last one is for a rest.
    """
    return "free", "constrained", *(f"{word} gave way" for word in words), "not solved"


def minimise(
    A: Array,
    b: Array,
    low: Array,
    high: Array,
    groups: tuple[Group, ...],
    units: Array | float = 1.0,
) -> Solution:
    """The x (n,) that minimises |A x - b|^2 with low <= x <= high and the inequalities of the
    groups.

    Where these contradict each other, groups give way in their order, the first one first: its
    inequalities are violated as little as the others allow. The bounds never do. The dual
    active-set method starts at the unconstrained minimum; most frames need no step from there.

    A, b: objective (m, n) and (m,). low, high: bounds (n,), low <= high. groups: the softest first.
    units: in which x is sought (n,).

    References: Arnström, Bemporad & Axehill 2022, doi:10.1109/TAC.2022.3176430 (the solver, DAQP);
    for the order in which constraints give way Escande, Mansard & Wieber 2014,
    doi:10.1177/0278364914521306.
    """
    numbers = [A, b]
    for group in groups:
        numbers += group.A, group.low
    if not all(map(all_finite, numbers)):
        return Solution(None, failure=f"{NOT_SOLVED}: it has numbers that are not finite")
    A = A * units
    low = low / units
    high = high / units
    groups = tuple(replace(group, A=group.A * units) for group in groups if len(group))
    H = A.T @ A
    mean = float(np.trace(H)) / len(H)
    if mean <= 0:
        return Solution(np.clip(np.zeros(len(H)), low, high) * units)
    H = H / mean
    f = -(A.T @ b) / mean
    H[np.diag_indices_from(H)] += 1e-9  # of many solutions the smallest is taken
    rows, floor = _of_unit_length(groups, len(H))
    upper = np.concatenate([high, np.full(len(rows), np.inf)])
    lower = np.concatenate([low, floor])
    # in `lower` and `upper` the bounds of x come first, then the rows of each group
    ends = len(low) + np.cumsum([0, *map(len, groups)])
    sense = np.zeros(len(upper), dtype=np.int32)
    for level in range(len(groups) + 1):  # so many groups may give way
        sense[ends[0] : ends[level]] = SOFT
        # A squared violation costs 1e6 times the mean curvature of the objective.
        x, _, code, info = load_solver()(
            H, f, rows, upper, lower, sense, iter_limit=ITERATIONS, rho_soft=1e-6
        )
        if code in SOLVED:
            gave_way = _violated(groups[:level], x)
            return Solution(np.clip(x, low, high) * units, gave_way, bool(np.any(info["lam"])))
        if code != INFEASIBLE:
            return Solution(None, failure=f"{NOT_SOLVED}: the solver stopped with code {code}")
    return Solution(None, failure=f"{NOT_SOLVED}: its bounds contradict each other")


def _violated(groups: tuple[Group, ...], x: Array) -> tuple[str, ...]:
    """Words of the groups of which x (n,) violates an inequality by more than rounding."""
    words = ()
    for group in groups:
        rounding = 1e-6 * np.maximum(np.linalg.norm(group.A, axis=1), 1e-12)
        if (group.A @ x - group.low < -rounding).any():
            words += (group.word,)
    return words


def _of_unit_length(groups: tuple[Group, ...], n: int) -> tuple[Array, Array]:
    """The rows (m, n) of all groups, each of the length 1, but for rows of zeros; and their low
    (m,).
    """
    none = Group.none("", n)  # for a program without groups
    rows = np.vstack([group.A for group in (none, *groups)])
    low = np.concatenate([group.low for group in (none, *groups)])
    size = np.linalg.norm(rows, axis=1)
    size[size < np.finfo(float).tiny] = 1.0
    return rows / size[:, None], low / size


@cache
def load_solver() -> Any:
    """The function that solves programs; a law loads it before its first frame."""
    import daqp  # here: checking and listing scenarios need not pay for it

    return daqp.solve


# Constraints on a robot's own velocities: joint limits, the picture's border, the target's plane,
# twist limits.


def velocity_bounds(
    robot: OwnModel, margin: float, damper_s: float, accelerate: bool
) -> tuple[Array, Array, bool]:
    """Bounds low, high (n,) of the velocities by positions, speeds and accelerations, and whether
    the accelerations had to give way.

    Speed towards a limit: at most (distance - margin) / damper_s (velocity damper), beyond the
    margin away from it at that rate; |rates| <= speed; |rates - ordered| <= acceleration period.
    Bounds of position win over those of speed, these over those of acceleration, so that
    low <= high always.

    margin: distance from a limit at which a velocity comes to rest [rad, m]. damper_s: not under a
    period [s]. accelerate: whether accelerations count.

    Reference: Faverjon & Tournassoud 1987, doi:10.1109/ROBOT.1987.1087982.
    """
    ahead = robot.q_then
    horizon = max(damper_s, robot.period_s)
    low = np.clip((robot.low + margin - ahead) / horizon, -robot.speed, robot.speed)
    high = np.clip((robot.high - margin - ahead) / horizon, -robot.speed, robot.speed)
    high = np.maximum(high, low)  # a range narrower than twice the margin
    if not accelerate:
        return low, high, False
    step = robot.acceleration * robot.period_s
    slow = robot.ordered - step
    fast = robot.ordered + step
    gave_way = bool((slow > high).any() or (fast < low).any())
    return np.clip(slow, low, high), np.clip(fast, low, high), gave_way


def off_singularities(robot: OwnModel, least: float, rate: float) -> Group:
    """A barrier of the smallest singular value s of the arm's Jacobian, lengths in its own unit:
    h = s - least, h_dot = u^T (dJ/dq x) v.

    It keeps an arm in its branch: beyond a singularity of the wrist the goal may need a joint
    position beyond a limit. Of an arm that starts at a singularity nobody knows which branch is the
    right one: there is no barrier under half of `least`.

    Reference: the derivative of a simple singular value: Stewart & Sun 1990, Matrix Perturbation
    Theory, section IV.2.
    """
    n = len(robot.names)
    scale = unit_scale(robot.unit_m)[:, None]
    U, s, Vt = np.linalg.svd(robot.J * scale)
    if n < 6 or not 0.5 * least < s[-1] < 4 * least:  # beyond 4, it could not bind within a frame
        return Group.none("singularity", n)
    u = U[:, len(s) - 1]
    v = Vt[len(s) - 1]
    step = 1e-6  # of finite differences [rad, m]
    changes = [robot.jacobian(robot.q + d) - robot.J for d in step * np.eye(n)]
    slopes = [u @ (scale * change) @ v / step for change in changes]
    return Group("singularity", np.array([slopes]), np.array([-rate * (s[-1] - least)]))


def shared_limits(robot: OwnModel, forward: float) -> Group:
    """Limits that several velocities share: sums of them (a platform's wheels), and the tightest
    circle of a vehicle that drives forward.

    forward: the sign of the wanted speed; the circle is |w| <= v / radius forward, and in reverse
    with -v.
    """
    A = np.vstack([robot.sums, -robot.sums])
    low = -np.tile(robot.most, 2)
    if robot.turning_radius_m > 0:
        circle = np.zeros((2, len(robot.names)))
        circle[:, 0] = (1.0 if forward >= 0 else -1.0) / robot.turning_radius_m
        circle[:, -1] = 1.0, -1.0
        A = np.vstack([A, circle])
        low = np.append(low, [0.0, 0.0])
    return Group("shared", A, low)


def twist_limits(speed_mps: float | None, rate_radps: float | None, J: Array) -> Group:
    """|v_i| <= speed_mps, |w_i| <= rate_radps (None: no limit) for each component of the camera
    twist J @ rates: a box.
    """
    parts = J.reshape(2, 3, -1)  # v and w
    A = np.stack([parts, -parts], axis=1).reshape(12, -1)
    low = -np.repeat([speed_mps or np.inf, rate_radps or np.inf], 6)
    return Group.finite("twist", A, low)


def border(seen: Observation, goal: Goal, robot: OwnModel, margin_px: float, rate: float) -> Group:
    """Barriers h_dot >= -rate h of each visible marker at each border of the picture: h = its
    edge's distance to it, less the margin [px].

    h_dot = n^T L J rates with n the border's inward normal, L the interaction matrix of the pixel
    in this lens, at the place where the marker will be when the command takes effect. A marker
    outside comes back at the rate.

    margin_px: distance of a marker's edge from the border [px]. rate: of the barrier [1/s].

    Reference: Ames, Coogan, Egerstedt, Notomista, Sreenath & Tabuada 2019,
    doi:10.23919/ECC.2019.8796030 (barrier functions).
    """
    rows = usable_rows(seen, inputs_in_space(seen), 1)
    if isinstance(rows, str) or len(goal.camera.panels) > 1:
        return Group.none("border", robot.J.shape[1])
    L = pixel_interaction(goal.camera, points(seen)[rows])
    there = seen.uv[rows] + L @ robot.way
    distance, inwards = goal.camera.borders(there)
    radius = 0.0 if seen.radius_px is None else seen.radius_px[rows][:, None]
    h = (distance - radius - margin_px).ravel()
    h_dot = np.einsum("nbk,nki->nbi", inwards, L).reshape(len(h), 6)
    return Group.finite("border", h_dot @ robot.J, -rate * h)


def above_plane(
    seen: Observation, goal: Goal, robot: OwnModel, distance_m: float, rate: float
) -> Group:
    """A barrier of the camera's distance to the plane of the target's markers: h = distance -
    distance_m [m].

    The markers in sight span the plane, by the law's own depths; of fewer than three, or of markers
    on one line, it is the one through their mean that faces the camera.
    """
    rows = usable_rows(seen, ("xy", "depth"), 1)
    if isinstance(rows, str):
        return Group.none("plane", robot.J.shape[1])
    p = points(seen)[rows]
    middle = p.mean(axis=0)
    _, s, Vt = np.linalg.svd(p - middle)
    flat = len(p) > 2 and s[1] > 1e-3 * s[0]
    normal = Vt[2] if flat else middle / np.linalg.norm(middle)
    away = float(normal @ middle)
    if away <= 0:
        normal = -normal  # towards the target
        away = -away
    h = away - float(normal @ robot.way[:3]) - distance_m
    # The camera's origin moves with v: its distance to a plane that stands still changes by -normal
    # . v.
    return Group("plane", -(normal @ robot.J[:3])[None], np.array([-rate * h]))
