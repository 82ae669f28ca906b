"""The metric my_metric: a figure of a run, computed from its log, for summary.json, the report and comparisons.

    pytest my_metric.py
    vstestbed run ibvs_book --plugin my_metric.py --set "metrics=[my_metric]"

The figure is the mean of the measured image error over the run [px], and the time during which it is over a limit [s].
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
    titles: ClassVar[Mapping[str, tuple[str, str]]] = {  # name in summary.json: title and unit in the reports
        "my_metric_mean_px": ("Mean image error", "px"),
        "my_metric_over_s": ("Time over the limit", "s"),
    }

    def part(self, setup):
        """What computes the figures of one run; setup: its robot, camera, target, law, detector."""
        return MyMetricPart(self.limit_px, setup.camera.period)


class MyMetricPart:
    """Sums over the log, which comes in blocks: a run of a day has no more memory than one of an hour."""

    def __init__(self, limit_px, period_s):
        self.limit_px, self.period_s = limit_px, period_s
        self.sum = self.frames = self.over = 0

    def add(self, log):
        """The next rows, by column (README, "log.parquet"), each (rows,); NaN in `error_px` where nothing is seen."""
        error = log["error_px"][np.isfinite(log["error_px"])]
        self.sum, self.frames = self.sum + float(error.sum()), self.frames + len(error)
        self.over += int((error > self.limit_px).sum())

    def figures(self):
        """A number for each name of `titles`, None where it is undefined."""
        return {"my_metric_mean_px": self.sum / self.frames if self.frames else None, "my_metric_over_s": self.over * self.period_s}


def test_my_metric():
    """Its figures are the same in whatever blocks it gets the log."""
    vstestbed.testing.check_metric(MyMetric())
