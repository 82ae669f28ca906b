"""Text and numbers of a run's page: outcome, tiles, table, timing, versions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import Any, Final

from vstestbed.loop.stability import reversal
from vstestbed.report.html.canvas import LINE_COLORS
from vstestbed.tasks.judged import MEASURED_BY, in_words_unit
from vstestbed.tasks.metrics import own_titles

Summary = Mapping[str, Any]


TILES: Final = (
    ("time_to_converge_s", "Time to converge", "s"),
    ("final_error_px", "Measured image error", "px"),
    ("final_position_error_m", "True position error", "m"),
    ("final_rotation_error_deg", "True rotation error", "deg"),
    ("path_length_m", "Path length", "m"),
    ("real_time_factor", "Real-time factor, films included", "×"),
)
GREY_TILE: Final = ("final_error_grey", "Measured image error", "grey levels")
"""In place of the second tile, of a law that works on grey levels and measures no markers."""
CONTINUING_TILES: Final = (("worst_task_error_m", "Largest error once settled", "m"), *TILES[4:])
"""Tiles of a continuing task, which has no goal pose to measure an error from."""
ROWS: Final = (
    ("seed", "Seed", ""),
    ("sim_time_s", "Simulated time", "s"),
    ("wall_time_s", "Wall time", "s"),
    ("frames", "Frames", ""),
    ("frames_lost", "Frames without target", ""),
    ("path_ratio", "Path over straight line", "×"),
    ("max_retreat_m", "Largest retreat", "m"),
    ("max_rotation_deg", "Largest rotation", "deg"),
    ("max_feature_excursion_px", "Largest feature excursion", "px"),
    ("feature_overshoot", "Overshoot of features", "×"),
    ("min_border_margin_px", "Smallest margin to the border", "px"),
    ("peak_speed_mps", "Peak speed", "m/s"),
    ("peak_rate_radps", "Peak rate of turn", "rad/s"),
    ("saturated_fraction", "Frames with a limited command", "%"),
)
TRACKING_ROWS: Final = (
    ("tracking_rms_px", "Tracking error, RMS", "px"),
    ("tracking_max_px", "Tracking error, largest", "px"),
    ("tracking_rms_m", "Camera from its goal, RMS", "m"),
    ("tracking_max_m", "Camera from its goal, largest", "m"),
)
"""Rows of a run with a moving target; measured after settling."""
MODE_ROWS: Final = (
    ("law_switches", "Switches of the law", ""),
    ("law_shortest_stay_s", "Shortest time between two switches", "s"),
)
"""Rows of a law with modes."""
LINK_ROWS: Final = (
    ("pictures_lost", "Pictures lost", ""),
    ("pictures_refused", "Pictures refused, out of order", ""),
    ("commands_lost", "Commands lost", ""),
)
"""Rows of a run with wrong time stamps, pictures out of order or a link that loses."""
SWING_ROWS: Final = (
    ("swung_s", "Longest time for which the command swung", "s"),
    ("swing_frames", "Period of that swing, in frames", ""),
)
"""Rows of a run whose command swung."""


def headline(summary: Summary) -> str:
    """The outcome as a box, coloured by success, with the reason in a sentence."""
    good = " good" if summary.get("success") else ""
    words = " ".join(filter(None, (_sentence(str(summary.get("reason") or "")), swing_text(summary), judged_text(summary))))
    return f'<div class="outcome{good}"><strong>{escape(outcome_text(summary))}</strong>{escape(words)}</div>'


def swing_text(summary: Summary) -> str:
    """That the command of a run swung for long, whatever its end; "" where it did not, or the outcome says so."""
    swung_s, frames = summary.get("swung_s"), summary.get("swing_frames")
    if not (_is_number(swung_s) and _is_number(frames)) or summary.get("outcome") == "unstable":
        return ""
    return f"On the way its command {reversal(float(frames or 0))}, for {plain(swung_s)} s without a break: it is badly damped."


def judged_text(summary: Summary) -> str:
    """Which error decided the task, and who measured it: `Task error by measured pixels: 0.12 px, limit 0.2 px.`; "" in older summaries."""
    if (by := summary.get("judged_by")) is None:
        return ""
    both = (summary["judged_error"], summary["judged_limit"])
    shown = [in_words_unit(x, str(summary["judged_unit"])) if _is_number(x) else None for x in both]
    value, limit = (f"{plain(x[0])} {x[1]}" if x else "unknown" for x in shown)
    return f"Task error by {MEASURED_BY[by]}: {value}, limit {limit}."


def outcome_text(summary: Summary) -> str:
    """The outcome as text: `Target lost` for `target_lost`."""
    return str(summary.get("outcome") or "no outcome").replace("_", " ").capitalize()


def tiles(summary: Summary) -> str:
    """The most important numbers."""
    shown = CONTINUING_TILES if "worst_task_error_m" in summary else TILES
    if "final_error_grey" in summary and summary.get("final_error_px") is None:
        shown = tuple(GREY_TILE if tile[0] == "final_error_px" else tile for tile in shown)
    items = [f"<div><dt>{name}</dt><dd>{_with_unit(summary.get(key), unit)}</dd></div>" for key, name, unit in shown]
    return f'<dl class="tiles">{"".join(items)}</dl>'


def table(summary: Summary) -> str:
    """The other numbers, one per line; those of the scenario's own metrics come last."""
    items = []
    own = tuple((key, *title) for key, title in own_titles().items() if key in summary)
    for key, name, unit in (
        ROWS + tuple(row for row in TRACKING_ROWS + MODE_ROWS + LINK_ROWS + SWING_ROWS if summary.get(row[0]) is not None) + own
    ):
        value = summary.get(key)
        if unit == "%" and isinstance(value, float):  # the summary holds shares
            value = 100 * value
        items.append(f"<div><dt>{escape(name)}</dt><dd>{_with_unit(value, escape(unit))}</dd></div>")
    return f'<dl class="numbers">{"".join(items)}</dl>'


def timing(summary: Summary) -> str:
    """Computing time of a frame by part, as a bar; empty if it was not measured."""
    parts = {str(k): float(v) for k, v in dict(summary.get("time_ms") or {}).items() if _is_number(v) and v >= 0}
    total = sum(parts.values())
    if total <= 0:
        return ""
    bar, keys = [], []
    for (name, ms), color in zip(parts.items(), LINE_COLORS * len(parts), strict=False):
        bar.append(f'<i style="width:{100 * ms / total:.2f}%;background:{color}" title="{escape(name)} {plain(ms)} ms"></i>')
        keys.append(f'<li><i style="background:{color}"></i>{escape(name)} {number(ms)} ms</li>')
    head = f'<h2>Where a frame\'s time went</h2><p class="soft">{number(total)} ms a frame</p>'
    return f'<section>{head}<div class="bar">{"".join(bar)}</div><ul class="key">{"".join(keys)}</ul></section>'


def provenance(summary: Summary) -> str:
    """Versions of the software that made the run."""
    versions = dict(summary.get("versions") or {})
    if not versions:
        return ""
    items = [f"<div><dt>{escape(str(k))}</dt><dd>{escape(str(v))}</dd></div>" for k, v in versions.items()]
    return f'<details><summary>Made with</summary><dl class="numbers" style="border:0">{"".join(items)}</dl></details>'


def number(value: object) -> str:
    """A number with three significant figures, as HTML: fixed point where that is short, else a power of ten; a dash if unknown."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "–" if value is None else escape(str(value))
    if isinstance(value, int):
        return str(value)
    if not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.2e}".split("e")
        return f"{mantissa}·10<sup>{int(exponent)}</sup>"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))  # three significant figures
    return f"{value:.{digits}f}"


def plain(value: object) -> str:
    """As `number`, without HTML, for text that is escaped as a whole: `1.23·10^-7`."""
    return number(value).replace("<sup>", "^").replace("</sup>", "")


def _with_unit(value: object, unit: str) -> str:
    """Number and unit as HTML; lengths under 10 cm in millimetres."""
    if unit == "m" and isinstance(value, float) and 0 < abs(value) < 0.1:
        value, unit = 1e3 * value, "mm"
    text = number(value)
    return f"{text} <span>{unit}</span>" if unit and text != "–" else text


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _sentence(words: str) -> str:
    """The text with a capital letter and a full stop."""
    return words[:1].upper() + words[1:].rstrip(".") + "." if words else ""
