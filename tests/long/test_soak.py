"""A run of a day: its memory does not grow, and no command on its folder needs much.

`VSTESTBED_SOAK_HOURS=24 python -m pytest -m study -s tests/long/test_soak.py` simulates so many hours (by default one) by rays and
prints the slope. The log of 24 hours at 25 Hz is made of rows of a short run.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.loop.log_file import FolderLog, open_log
from vstestbed.studies.run_folder import run_into

HOURS = float(os.environ.get("VSTESTBED_SOAK_HOURS", "1"))
MOST_GROWTH_MB = 1.0
"""An hour of simulated time may cost this much memory; the rows alone, kept in memory, would be 9 MB."""
MOST_MB = 300
SOAK = """
import sys
import numpy as np, vstestbed as vs
from pathlib import Path
from vstestbed.studies.run_folder import run_into
class Memory:
    at = []
    def frame(self, frame):
        if frame.timing.number % 100 == 0:
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            self.at.append((frame.timing.t / 3600, pages * 4096 / 1e6))
folder, hours = Path(sys.argv[1]), float(sys.argv[2])
folder.mkdir()
text = '''
robot: {kind: free, start: {nominal: {xyz: [0.1, -0.05, 0]}}}
camera: {width: 160, height: 120, rate_hz: 5, renderer: rays}
target: {kind: square, side: 0.4, pose: {xyz: [0, 0, 1.2]}, marker: {radius: 0.05}}
detector: blobs
law: {kind: ibvs, gain: 1}
noise: {pixel_sigma_px: 0.1}
goal: {T_camera_target: {xyz: [0, 0, 1]}}
stop: {duration_s: %s, converged: {error_px: 1e-9}}
''' % (3600 * hours)
path = folder.parent / "soak.yaml"
path.write_text(text)
run_into(folder, vs.load(path), "none", [Memory()], report=False)
t, mb = np.array(Memory.at).T
settled = t > t[-1] / 4  # pools and caches are filled by then
print(np.polyfit(t[settled], mb[settled], 1)[0], mb[settled].min(), mb.max())
"""


COMMAND = "from vstestbed.cli.app import main\ntry: main(sys.argv[1:])\n"
FINISH = "from pathlib import Path\nfrom vstestbed.loop.log_file import FolderLog\ntry: FolderLog(Path(sys.argv[2])).finish()\n"


def peak_mb(*words: str, code: str = COMMAND) -> float:
    """The largest resident memory of a command, or of other code [MB]."""
    # Not getrusage, whose peak begins with that of the parent process.
    code = f"import re, sys\n{code}"
    code += "finally: print(re.search(r'VmHWM:\\s*(\\d+)', open('/proc/self/status').read())[1])"
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1]) / 1e3


@pytest.mark.study
def test_memory_does_not_grow_with_the_time(tmp_path: Path):
    done = subprocess.run([sys.executable, "-c", SOAK, str(tmp_path / "run"), str(HOURS)], capture_output=True, text=True, check=True)
    slope, least, most = map(float, done.stdout.split())
    print(f"{HOURS:g} h: {slope:.2f} MB an hour, {least:.0f} to {most:.0f} MB")
    assert len(open_log(tmp_path / "run")) == round(HOURS * 3600 * 5) + 1
    assert slope < MOST_GROWTH_MB
    assert not (tmp_path / "run" / "log.part").exists()


@pytest.mark.study
def test_a_log_of_a_day_at_25_hz_is_read_in_little_memory(tmp_path: Path):
    folder = tmp_path / "run"
    folder.mkdir()
    recording = run_into(folder, vs.load("ibvs_book", {"stop.duration_s": 2.0}), "none", report=False)
    table, columns, n = recording.table, recording.columns, 24 * 3600 * 25 + 1
    (folder / "log.parquet").unlink()
    log = FolderLog.create(folder, columns)
    for start in range(0, n, 4096):
        number = np.arange(start, min(start + 4096, n))
        rows = table[number % len(table)]
        rows[:, columns.index("frame")], rows[:, columns.index("t")] = number, number / 25
        log.append(rows)
    log.close()
    part = peak_mb("report", str(folder), "--quiet")
    finish = peak_mb("finish", str(folder), code=FINISH)
    parquet = peak_mb("report", str(folder), "--quiet")
    page = (folder / "report.html").stat().st_size / 1e6
    print(
        f"{n} rows: report {part:.0f} MB from log.part, {finish:.0f} MB to finish it, {parquet:.0f} MB from log.parquet; page {page:.1f} MB"
    )
    assert max(part, finish, parquet) < MOST_MB
