"""A run of a day: its memory grows by the rows of its log alone.

`VSTESTBED_SOAK_HOURS=24 python -m pytest -m study -s tests/long/test_soak.py` simulates so many
hours (by default one) by rays and prints the slope.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from vstestbed.loop.log_file import open_log

HOURS = float(os.environ.get("VSTESTBED_SOAK_HOURS", "1"))
MOST_GROWTH_MB = 10.0
"""An hour of simulated time may cost this much memory: the rows of the log, 18,000 of 62 numbers,
are 9 MB.
"""
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


@pytest.mark.study
def test_memory_does_not_grow_with_the_time(tmp_path: Path):
    done = subprocess.run(
        [sys.executable, "-c", SOAK, str(tmp_path / "run"), str(HOURS)],
        capture_output=True,
        text=True,
        check=True,
    )
    slope, least, most = map(float, done.stdout.split())
    print(f"{HOURS:g} h: {slope:.2f} MB an hour, {least:.0f} to {most:.0f} MB")
    assert len(open_log(tmp_path / "run")) == round(HOURS * 3600 * 5) + 1
    assert slope < MOST_GROWTH_MB
    assert not (tmp_path / "run" / "log.part").exists()
