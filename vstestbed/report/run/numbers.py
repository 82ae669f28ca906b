"""The words and numbers of the page: outcome, tiles, table, timing, versions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import Any, Final

from vstestbed.report.html.canvas import LINE_COLORS

Summary = Mapping[str, Any]

TILES: Final = (
    ("time_to_converge_s", "Time to converge", "s"),
    ("final_error_px", "Final error", "px"),
    ("final_position_error_m", "Position error", "m"),
    ("final_rotation_error_deg", "Rotation error", "deg"),
    ("path_length_m", "Path length", "m"),
    ("real_time_factor", "Real-time factor, films included", "×"),
)
CONTINUING_TILES: Final = (("worst_off_m", "Largest error once settled", "m"), *TILES[4:])
"""Of a task without an end, which has no goal to be away from."""
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
"""Of a target that moves, once settled."""


def headline(summary: Summary) -> str:
    """The outcome in large letters, coloured by success, with the sentence that says why."""
    good = " good" if summary.get("success") else ""
    reason = str(summary.get("reason") or "")
    return f'<div class="outcome{good}"><strong>{escape(outcome_text(summary))}</strong>{escape(_sentence(reason))}</div>'


def outcome_text(summary: Summary) -> str:
    """The outcome as words: `Target lost` for `target_lost`."""
    return str(summary.get("outcome") or "no outcome").replace("_", " ").capitalize()


def tiles(summary: Summary) -> str:
    """The few numbers one looks for first."""
    shown = CONTINUING_TILES if "worst_off_m" in summary else TILES
    made = [f"<div><dt>{name}</dt><dd>{_with_unit(summary.get(key), unit)}</dd></div>" for key, name, unit in shown]
    return f'<dl class="tiles">{"".join(made)}</dl>'


def table(summary: Summary) -> str:
    """The other numbers, one a line."""
    made = []
    for key, name, unit in ROWS + tuple(row for row in TRACKING_ROWS if summary.get(row[0]) is not None):
        value = summary.get(key)
        if unit == "%" and isinstance(value, float):
            value = 100 * value
        made.append(f"<div><dt>{name}</dt><dd>{_with_unit(value, unit)}</dd></div>")
    return f'<dl class="numbers">{"".join(made)}</dl>'


def timing(summary: Summary) -> str:
    """Where the time of a frame went, as a bar; empty where it was not measured."""
    parts = {str(k): float(v) for k, v in dict(summary.get("time_ms") or {}).items() if _is_number(v) and v >= 0}
    total = sum(parts.values())
    if total <= 0:
        return ""
    bar, keys = [], []
    for (name, ms), color in zip(parts.items(), LINE_COLORS * len(parts), strict=False):
        bar.append(f'<i style="width:{100 * ms / total:.2f}%;background:{color}" title="{escape(name)} {ms:.3g} ms"></i>')
        keys.append(f'<li><i style="background:{color}"></i>{escape(name)} {ms:.3g} ms</li>')
    head = f'<h2>Where a frame\'s time went</h2><p class="soft">{total:.3g} ms a frame</p>'
    return f'<section>{head}<div class="bar">{"".join(bar)}</div><ul class="key">{"".join(keys)}</ul></section>'


def provenance(summary: Summary) -> str:
    """What the run was made with."""
    versions = dict(summary.get("versions") or {})
    if not versions:
        return ""
    made = [f"<div><dt>{escape(str(k))}</dt><dd>{escape(str(v))}</dd></div>" for k, v in versions.items()]
    return f'<details><summary>Made with</summary><dl class="numbers" style="border:0">{"".join(made)}</dl></details>'


def number(value: object) -> str:
    """A number with three significant figures, plain where that is short; a dash for what is not known."""
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
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}"


def _with_unit(value: object, unit: str) -> str:
    """Number and unit; lengths under 10 cm in millimetres."""
    if unit == "m" and isinstance(value, float) and 0 < abs(value) < 0.1:
        value, unit = 1e3 * value, "mm"
    text = number(value)
    return f"{text} <span>{unit}</span>" if unit and text != "–" else text


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _sentence(words: str) -> str:
    """With a capital letter and a full stop."""
    return words[:1].upper() + words[1:].rstrip(".") + "." if words else ""
