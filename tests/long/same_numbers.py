"""Do two checkouts leave the same numbers?
`python tests/long/same_numbers.py OLD NEW [SCENARIO ...]`.

For before and after a change of structure.
Every bundled scenario (or those named) runs once in each checkout, and `compare canonical` after
them. Printed for each run is whether its `log.parquet` is the same bytes, or the same numbers under
other column names (`RENAMED`), and whether its summary is the same. The exit code is 1 where
anything else differs. Results are kept in the folder `--keep`, so that an old checkout need not run
again.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import polars as pl

RENAMED = {
    "made_": "applied_",
    "ask_": "ref_",
    "fly_": "est_",
    "off_m": "task_error_m",
    "pilot": "supervisor",
    "worst_off_m": "worst_task_error_m",
}
"""Beginnings of columns that are called otherwise in the newer checkout."""
OF_THE_CLOCK = {"wall_time_s", "real_time_factor", "time_ms", "versions"}
"""What a summary has that is not of the simulated run."""
ONE_RUN = """
import json, pathlib, sys, vstestbed as vs
out = pathlib.Path(sys.argv[1])
recording = vs.run(vs.load(sys.argv[2]))
recording.frame().write_parquet(out / "log.parquet")
(out / "summary.json").write_text(json.dumps(recording.summary()))
"""


def python_in(checkout: Path, *arguments: str) -> None:
    """Run this interpreter on a checkout's package."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "MUJOCO_GL": "egl"}
    done = subprocess.run(
        [sys.executable, *arguments],
        env=environment,
        cwd="/",
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode not in (0, 3):
        raise SystemExit(f"{checkout}: {' '.join(arguments)[-80:]}\n{done.stderr[-2000:]}")


def run_once(checkout: Path, name: str, keep: Path) -> Path:
    """The folder with one scenario's log and summary, made where it is not there yet."""
    out = keep / name
    if not (out / "summary.json").exists():
        out.mkdir(parents=True, exist_ok=True)
        python_in(checkout, "-c", ONE_RUN, str(out), name)
    return out


def canonical(checkout: Path, keep: Path) -> pl.DataFrame:
    """The table of `compare canonical`."""
    out = keep / "compare_canonical"
    if not (out / "comparison.parquet").exists():
        python_in(
            checkout,
            "-m",
            "vstestbed",
            "compare",
            "canonical",
            "--jobs",
            "2",
            "--quiet",
            "--out",
            str(out),
        )
    return pl.read_parquet(out / "comparison.parquet")


def renamed(column: str) -> str:
    """The newer name of a column."""
    return next(
        (new + column[len(old) :] for old, new in RENAMED.items() if column.startswith(old)), column
    )


def same_table(a: pl.DataFrame, b: pl.DataFrame, columns: list[str]) -> list[str]:
    """Names of columns whose numbers differ (NaN is NaN)."""
    lacking = [c for c in columns if renamed(c) not in b.columns and c not in b.columns]
    both = [(c, c if c in b.columns else renamed(c)) for c in columns if c not in lacking]
    return lacking + [
        c for c, d in both if len(a) != len(b) or column_bytes(a[c]) != column_bytes(b[d])
    ]


def column_bytes(column: pl.Series) -> bytes:
    """The bits of a column, so that -0 is not 0 and NaN is NaN."""
    return (
        column.to_numpy().tobytes()
        if column.dtype.is_numeric()
        else repr(column.to_list()).encode()
    )


def of_the_run(summary: dict[str, Any]) -> dict[str, Any]:
    """A summary without what the clock and the machine put into it."""
    return {k: v for k, v in summary.items() if k not in OF_THE_CLOCK}


def verdict(old: Path, new: Path) -> tuple[bool, str]:
    """Whether two runs' folders tell the same, and the words for it."""
    a, b = (json.loads((f / "summary.json").read_text()) for f in (old, new))
    a, b = of_the_run(a), of_the_run(b)
    words = [f"summary: {k}: {a[k]} -> {b.get(renamed(k))}" for k in a if a[k] != b.get(renamed(k))]
    if (old / "log.parquet").read_bytes() == (new / "log.parquet").read_bytes():
        return not words, "; ".join(["the same bytes", *words])
    x, y = pl.read_parquet(old / "log.parquet"), pl.read_parquet(new / "log.parquet")
    differ = same_table(x, y, x.columns)
    said = (
        f"columns differ: {', '.join(differ)}"
        if differ
        else f"the same {x.height} x {x.width} numbers, columns renamed"
    )
    return not differ and not words, "; ".join([said, *words])


def main() -> int:
    """Compare two checkouts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("scenarios", nargs="*")
    parser.add_argument("--keep", type=Path, default=Path("/tmp/same_numbers"))
    asked = parser.parse_args()
    names = asked.scenarios or sorted(p.stem for p in (asked.old / "scenarios").glob("*.yaml"))
    keeps = [asked.keep / re.sub(r"\W+", "_", str(c.resolve())) for c in (asked.old, asked.new)]
    good = True
    with ThreadPoolExecutor(2) as pool:
        sides = zip((asked.old, asked.new), keeps, strict=True)
        made = [
            [pool.submit(run_once, checkout.resolve(), name, keep) for name in names]
            for checkout, keep in sides
        ]
        for name, old, new in zip(names, *made, strict=True):
            same, words = verdict(old.result(), new.result())
            good &= same
            print(f"{'same' if same else 'DIFFERENT':10} {name:26} {words}", flush=True)
    if not asked.scenarios:
        a, b = (
            canonical(c.resolve(), k) for c, k in zip((asked.old, asked.new), keeps, strict=True)
        )
        columns = [c for c in a.columns if c.split(".")[0] not in OF_THE_CLOCK]
        differ = same_table(a, b, columns)
        good &= not differ
        print(
            f"{'DIFFERENT' if differ else 'same':10} compare canonical, {a.height} runs:"
            f" {', '.join(differ) or 'the same table'}"
        )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
