"""Fill the rendered parts of the pages: `python -m docs.build [PAGE ...] [--again [PATTERN ...]]`.

Without options only commands without a kept result are run. `--again` runs all again (hours), or
those that match a pattern (`--again 'compare *'`). What changed on a page is said, line by line.
"""

from __future__ import annotations

import argparse
import fnmatch
import sys
from pathlib import Path

from docs.build.kept import FOLDER, REPOSITORY, Kept, place_of
from docs.build.marks import differences, filled
from docs.build.pages import environment, pages
from vstestbed.core.files import write_whole


def main() -> None:
    """Fill the pages that are asked for, or all."""
    parser = argparse.ArgumentParser(prog="python -m docs.build", description=__doc__)
    parser.add_argument(
        "page", nargs="*", type=Path, help="such as scenarios/README.md; by default all"
    )
    parser.add_argument("--again", nargs="*", metavar="PATTERN", help="commands that are run again")
    asked = parser.parse_args()
    patterns = ["*"] if asked.again == [] else asked.again or []
    kept = Kept(
        again=lambda command: any(fnmatch.fnmatch(command, pattern) for pattern in patterns)
    )
    known = environment(kept)
    for page in asked.page or pages():
        place = REPOSITORY / page
        before = place.read_text(encoding="utf-8")
        now = filled(before, known)
        for line in differences(page, before, now):
            sys.stdout.write(line + "\n")
        if now != before:
            write_whole(place, now)
    if not asked.page:
        for file in set(FOLDER.glob("*.json")) - {place_of(command) for command in kept.used}:
            sys.stdout.write(f"no page asks for {file.name} any more: removed\n")
            file.unlink()


main()
