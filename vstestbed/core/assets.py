"""The folders models/ and scenarios/: inside an installed package, or beside it in a checkout."""

from __future__ import annotations

from pathlib import Path

from vstestbed.core.errors import OutputError
from vstestbed.core.named_files import PACKAGE, place_of_file

_PACKAGE = Path(__file__).resolve().parent.parent


def folder(name: str) -> Path:
    """The folder `models` or `scenarios`: `vstestbed/_data/<name>` in a wheel, `<checkout>/<name>` otherwise."""
    # The wheel's copy first: beside an installed package, a folder of this name would belong to somebody else.
    for candidate in (_PACKAGE / "_data" / name, _PACKAGE.parent / name):
        if candidate.is_dir():
            return candidate
    raise OutputError(_PACKAGE, f"the folder {name}/ is missing from the installation", "install vstestbed again")


def model_path(name: str) -> Path:
    """The MJCF file `name` in models/, or a robot's own by its whole path, or inside a package (`package:NAME/path`)."""
    return place_of_file(name) if name.startswith(PACKAGE) else folder("models") / name


def bundled_scenarios() -> dict[str, Path]:
    """Path of every bundled scenario by its name, sorted."""
    return {p.stem: p for p in sorted(folder("scenarios").glob("*.yaml"))}


def bundled_comparisons() -> dict[str, Path]:
    """Path of every bundled comparison by its name, sorted."""
    return {p.stem: p for p in sorted((folder("scenarios") / "compare").glob("*.yaml"))}
