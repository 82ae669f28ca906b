"""The stop block of a scenario: convergence conditions and time limits."""

from __future__ import annotations

import math

from vstestbed.core.quantity import (
    Duration,
    PositiveAngle,
    PositiveGrey,
    PositiveLength,
    PositivePixels,
    PositiveTime,
    Time,
)
from vstestbed.core.spec import spec

__all__ = ["Converged", "Stop"]


@spec
class Converged:
    """When the goal counts as reached: every condition given holds for hold_s. Without any,
    error_px is 0.2.

    Args:
        error_px: all markers are seen, and their RMS error is under this [px].
        position_m, rotation_deg: largest distance from the goal by the law's own estimate (the pose
            from the markers; a vehicle's place) [m, deg].
        error_grey: RMS difference between picture and goal picture, of a law that works on grey
            levels (`photometric`), is under this [grey levels]; e.g. `1`.
        hold_s: how long all conditions must hold [s].
    """

    error_px: PositivePixels | None = None
    position_m: PositiveLength | None = None
    rotation_deg: PositiveAngle | None = None
    error_grey: PositiveGrey | None = None
    hold_s: Time = 0.5

    def __post_init__(self) -> None:
        """Without a condition, 0.2 px."""
        if self.error_px is None and not self.by_estimate and self.error_grey is None:
            # Past the frozen dataclass: whether there is a default depends on the other fields.
            object.__setattr__(self, "error_px", 0.2)

    @property
    def by_estimate(self) -> bool:
        """Whether the robot's own estimate counts."""
        return self.position_m is not None or self.rotation_deg is not None

    def near(
        self,
        all_seen: bool,
        error_px: float,
        position_m: float,
        rotation_rad: float,
        error_grey: float = math.nan,
    ) -> bool:
        """Whether the conditions hold; an unknown quantity (NaN) does not satisfy its condition."""
        if self.error_px is not None and not (all_seen and error_px < self.error_px):
            return False
        if self.error_grey is not None and not error_grey < self.error_grey:
            return False
        if self.position_m is not None and not position_m < self.position_m:
            return False
        return self.rotation_deg is None or math.degrees(rotation_rad) < self.rotation_deg

    @property
    def summary(self) -> str:
        """The conditions in words."""
        conditions = (
            (self.error_px, "RMS error under {:g} px"),
            (self.error_grey, "RMS error under {:g} grey levels"),
            (self.position_m, "under {:g} m"),
            (self.rotation_deg, "under {:g} deg"),
        )
        said = ", ".join(form.format(value) for value, form in conditions if value is not None)
        if self.error_px is None and self.error_grey is None:
            return f"by its own estimate {said} off"
        return said


@spec
class Stop:
    """End of a run.

    Args:
        duration_s: simulated time after which the run times out [s]; at most a day.
        converged: when the goal counts as reached.
        lost_after_s: longest time without sight of the target [s]; then the robot stops; None: it
            goes on for any time.
        lost_after_m: longest way of the camera without sight of the target, by the robot's own
            sensors (dead reckoning, or a law that coasts) [m]; then the robot stops; None: it goes
            on for any way. Where both are None, a camera behind its target goes on, too.
        rest_after_s: how long a commanded rest away from the goal lasts until the run ends as
            `local_minimum` [s]; None: it never ends so.
        frozen_after_s: how long pictures may be the same to the byte while a velocity is ordered,
            until the camera counts as frozen and the robot stops (`target_lost`) [s], counted for
            each camera, further ones and depth pictures, too; None: a real camera's are told in the
            cycle's notes, and end nothing; e.g. `1`.
    """

    duration_s: Duration = 30.0
    converged: Converged = Converged()
    lost_after_s: Time | None = 1.0
    lost_after_m: PositiveLength | None = 2.0
    rest_after_s: Time | None = 2.0
    frozen_after_s: PositiveTime | None = None

    @property
    def lost_after(self) -> tuple[float, float]:
        """The time [s] and the way [m] after which a target that is out of sight is lost; inf:
        never.
        """
        return _or_never(self.lost_after_s), _or_never(self.lost_after_m)

    @property
    def frozen_after(self) -> float:
        """How long pictures may be the same while a velocity is ordered [s]; inf: for ever."""
        return _or_never(self.frozen_after_s)

    @property
    def rest_after(self) -> float:
        """How long a commanded rest away from the goal must last to count as a local minimum [s];
        inf: it never does.
        """
        return _or_never(self.rest_after_s)

    @property
    def loss_ends(self) -> bool:
        """Whether a run can end as `target_lost`."""
        return min(self.lost_after) < math.inf


def _or_never(limit: float | None) -> float:
    return math.inf if limit is None else limit
