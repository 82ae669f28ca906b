"""The folders models/ and scenarios/: inside an installed package, or beside it in a checkout."""

from __future__ import annotations

from functools import lru_cache
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
    return _listed(folder("scenarios"))


def bundled_comparisons() -> dict[str, Path]:
    """Path of every bundled comparison by its name, sorted."""
    return _listed(folder("scenarios") / "compare")


def _listed(place: Path) -> dict[str, Path]:
    return dict(_files(place, place.stat().st_mtime_ns))  # the caller may change it


@lru_cache(maxsize=8)
def _files(place: Path, changed_ns: int) -> dict[str, Path]:
    # kept until a file comes or goes: a comparison loads hundreds of scenarios by their names
    return {p.stem: p for p in sorted(place.glob("*.yaml"))}
