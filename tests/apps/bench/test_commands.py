"""The command `bench`."""

from __future__ import annotations

import json
from pathlib import Path


def test_bench_tells_of_the_loop_and_its_floor(command, quick: Path) -> None:
    ended = command("bench", "quick.yaml", "--repeats", 1, "--json")
    result = json.loads(ended.out)
    assert ended.code == 0
    assert result["scenario"] == "quick"
    assert result["frames"] == 30
    assert {"physics", "render", "detect", "law", "record", "other", "whole"} <= set(
        result["ms_per_frame"]
    )


def test_words_that_are_refused(command, quick: Path) -> None:
    ended = command("bench", "quick.yaml", "--repeats", "0")
    assert (ended.code, ended.out) == (2, "")
    assert "Invalid value for '--repeats'" in ended.err
    ended = command("bench", "nowhere")
    assert (ended.code, ended.out) == (2, "")
    assert ended.err.startswith("nowhere: no such file")
    assert ended.err.count("\n") == 1


def test_help(command) -> None:
    ended = command("bench", "--help")
    assert ended.code == 0
    assert ended.out.startswith("Usage: vstestbed bench")
