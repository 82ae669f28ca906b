"""The metric my_metric: a figure of a run, computed from its log, for summary.json, the report and
comparisons.

    pytest my_metric.py
    vstestbed run ibvs_book --plugin my_metric.py --set "metrics=[my_metric]"

The figure is the mean of the measured image error over the run [px], and the time during which it
is over a limit [s].
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Gt

import vstestbed as vs
import vstestbed.testing


@vs.METRICS.add
@vs.spec
class MyMetric:
    """Mean error, and the time over a limit.

    Args:
        limit_px: the limit [px].
    """

    kind: Literal["my_metric"] = "my_metric"  # its word in a scenario
    limit_px: Annotated[float, Gt(0)] = 50.0
    # name in summary.json: title, unit; (..., 100, 1): shown times 100, more is better
    titles: ClassVar[Mapping[str, tuple[str, str]]] = {
        "my_metric_mean_px": ("Mean image error", "px"),
        "my_metric_over_s": ("Time over the limit", "s"),
    }

    def figures(self, log, setup):
        """A number for each name of `titles`, None where it is undefined.

        log: its columns by name (`vstestbed describe log`), one row a frame; NaN in `error_px`
        where nothing is seen. setup: the experiment's robot, camera, target, law, detector.
        """
        error = log["error_px"][np.isfinite(log["error_px"])]
        over_s = float((error > self.limit_px).sum() * setup.camera.period)
        return {
            "my_metric_mean_px": float(error.mean()) if len(error) else None,
            "my_metric_over_s": over_s,
        }


def test_my_metric():
    """Its figures are numbers under names of their own."""
    vstestbed.testing.check_metric(MyMetric())
