"""The figure of time to converge over latency, and of gain limits over delay, from the results that
the pages keep.
"""

from __future__ import annotations

from pathlib import Path
from statistics import median

from docs.build.kept import Kept
from docs.build.render import where

LAWS = {
    "points": ("points", "gain-limit arm_ibvs", "tab:red"),
    "smith": (
        "points, Smith's predictor",
        "gain-limit arm_ibvs --set law.feedforward=smith",
        "tab:blue",
    ),
    "predictive": ("predictive", "gain-limit arm_ibvs --set law=predictive", "tab:green"),
}
FRAME_S = 0.04


def draw(place: Path) -> None:
    """Write the figure."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    kept = Kept(may_run=False)
    rows = kept("compare latency")
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), constrained_layout=True)
    for i, (law, (label, command, colour)) in enumerate(LAWS.items()):
        for s in sorted({row["camera.latency_s"] for row in rows}):
            of = where(rows, law=law, **{"camera.latency_s": s})
            times = sorted(row["time_to_converge_s"] for row in of if row["success"])
            x = 1e3 * s + 5 * (i - 1)
            left.plot([x, x], [times[0], times[-1]], color=colour, lw=1.5)
            left.plot(x, median(times), "o", color=colour, label=label if s == 0 else None)
            if len(times) < len(of):
                left.annotate(
                    f"{len(times)}/{len(of)}",
                    (x, times[-1]),
                    textcoords="offset points",
                    xytext=(0, 3),
                    ha="center",
                    color=colour,
                )
        limits = kept(command)
        d = [1e3 * FRAME_S * row["delay_frames"] for row in limits]
        right.plot(d, [row["gain_limit"] for row in limits], "o-", color=colour, label=label)
        for at, row in zip(d, limits, strict=True):
            if row.get("unlimited"):
                right.annotate(
                    "",
                    (at, 1.5 * row["gain_limit"]),
                    (at, row["gain_limit"]),
                    arrowprops={"arrowstyle": "->", "color": colour},
                )
    left.set(xlabel="latency [ms]", ylabel="time to converge [s], gain 4 1/s", ylim=(0, 26))
    right.set(xlabel="delay [ms]", ylabel="gain limit [1/s]", yscale="log", ylim=(4, 300))
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(loc="upper left" if axes is left else "lower left")
    figure.savefig(place, dpi=118)
    plt.close(figure)
