"""Text and numbers of a run's page: outcome, tiles, table, timing, versions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from html import escape
from typing import Any, Final

from vstestbed.loop.stability import reversal
from vstestbed.report.html.canvas import LINE_COLORS
from vstestbed.report.html.template import number, plain
from vstestbed.tasks.judged import MEASURED_BY, in_words_unit
from vstestbed.tasks.metrics import own_titles

Summary = Mapping[str, Any]
TILES: Final = {
    "time_to_converge_s": ("Time to converge", "s"),
    "final_error_px": ("Measured image error", "px"),
    "final_error_grey": ("Measured image error", "grey levels"),
    "worst_task_error_m": ("Largest error once settled", "m"),
    "final_position_error_m": ("True position error", "m"),
    "final_rotation_error_deg": ("True rotation error", "deg"),
    "path_length_m": ("Path length", "m"),
    "real_time_factor": ("Real-time factor, films included", "×"),
}
ROWS: Final = {
    "seed": ("Seed", ""),
    "sim_time_s": ("Simulated time", "s"),
    "wall_time_s": ("Wall time", "s"),
    "frames": ("Frames", ""),
    "frames_lost": ("Frames without target", ""),
    "path_ratio": ("Path over straight line", "×"),
    "max_retreat_m": ("Largest retreat", "m"),
    "max_rotation_deg": ("Largest rotation", "deg"),
    "max_feature_excursion_px": ("Largest feature excursion", "px"),
    "feature_overshoot": ("Overshoot of features", "×"),
    "min_border_margin_px": ("Smallest margin to the border", "px"),
    "peak_speed_mps": ("Peak speed", "m/s"),
    "peak_rate_radps": ("Peak rate of turn", "rad/s"),
    "saturated_fraction": ("Frames with a limited command", "%"),
}
OF_SOME_RUNS: Final = {
    "tracking_rms_px": ("Tracking error, RMS", "px"),
    "tracking_max_px": ("Tracking error, largest", "px"),
    "tracking_rms_m": ("Camera from its goal, RMS", "m"),
    "tracking_max_m": ("Camera from its goal, largest", "m"),
    "law_switches": ("Switches of the law", ""),
    "law_shortest_stay_s": ("Shortest time between two switches", "s"),
    "pictures_lost": ("Pictures lost", ""),
    "pictures_refused": ("Pictures refused, out of order", ""),
    "commands_lost": ("Commands lost", ""),
    "swung_s": ("Longest time for which the command swung", "s"),
    "swing_frames": ("Period of that swing, in frames", ""),
}
"""Of a moving target (measured after settling); a law with modes; wrong time stamps or a lossy link; a command that swung."""
TITLES: Final = TILES | ROWS | OF_SOME_RUNS  # title and unit of each number of `summary.json`
CONTINUING: Final = ("worst_task_error_m", "path_length_m", "real_time_factor")
"""Tiles of a continuing task, which has no goal pose to measure an error from."""


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
    """The most important numbers; of a law that works on grey levels and measures no markers the error in grey levels."""
    other = "px" if "final_error_grey" in summary and summary.get("final_error_px") is None else "grey"
    ended = (name for name in TILES if name not in (f"final_error_{other}", "worst_task_error_m"))
    shown = CONTINUING if "worst_task_error_m" in summary else ended
    return _list("tiles", ((TITLES[name][0], _with_unit(summary.get(name), TITLES[name][1])) for name in shown))


def table(summary: Summary) -> str:
    """The other numbers, one per line; those of the scenario's own metrics come last."""
    own = own_titles()
    names = (*ROWS, *(name for name in OF_SOME_RUNS if summary.get(name) is not None), *(name for name in own if name in summary))
    items = []
    for name in names:
        title, unit = TITLES.get(name) or own[name]
        value = summary.get(name)
        if unit == "%" and isinstance(value, float):  # the summary holds shares
            value = 100 * value
        items.append((escape(title), _with_unit(value, escape(unit))))
    return _list("numbers", items)


def _list(kind: str, items: Iterable[tuple[str, str]], more: str = "") -> str:
    """Titles with their values, all HTML."""
    return f'<dl class="{kind}"{more}>{"".join(f"<div><dt>{title}</dt><dd>{value}</dd></div>" for title, value in items)}</dl>'


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
    items = _list("numbers", ((escape(str(k)), escape(str(v))) for k, v in versions.items()), ' style="border:0"')
    return f"<details><summary>Made with</summary>{items}</details>"


def _with_unit(value: object, unit: str) -> str:
    """Number and unit as HTML; lengths under 10 cm in millimetres."""
    if unit == "m" and isinstance(value, float) and 0 < abs(value) < 0.1:
        value, unit = 1e3 * value, "mm"
    text = number(value)
    return f"{text} <span>{unit}</span>" if unit and text != "–" else text


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:].rstrip(".") + "." if words else ""
