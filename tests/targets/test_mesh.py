"""Solids as targets: files, markers on the surface,
what a solid hides of its own markers, names.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.core.named_files import folder
from vstestbed.targets import MeshTarget, Points, Square
from vstestbed.targets.markers import Disc, Sphere
from vstestbed.targets.mesh import as_stl, nearest, read_triangles

FLANGE = str(folder("scenarios") / "targets" / "flange.stl")
FACES = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
CORNERS = np.array(
    [[0, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 0], [0, 0, 2], [4, 0, 2], [4, 3, 2], [0, 3, 2]], float
)
BOX = np.concatenate([[CORNERS[[a, b, c]], CORNERS[[a, c, d]]] for a, b, c, d in FACES])
TEXT = "solid box\n" + "".join(
    "facet normal 0 0 0\nouter loop\n"
    + "".join(f"vertex {x} {y} {z}\n" for x, y, z in t)
    + "endloop\nendfacet\n"
    for t in BOX
)
OBJ = "# a box\nmtllib box.mtl\n" + "".join(f"v {x} {y} {z} 1 0 0\n" for x, y, z in CORNERS)
OBJ += "".join("f " + " ".join(f"{i + 1}/1/{i - 8}" for i in face) + "\n" for face in FACES[:3])
# counted back from the last vertex
OBJ += "".join("f " + " ".join(str(i - 8) for i in face) + "\n" for face in FACES[3:])


def solid(**settings: Any) -> MeshTarget:
    return MeshTarget(pose=Pose(), **settings)


def written(path: Path, content: bytes | str) -> str:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return str(path)


@pytest.mark.parametrize(
    ("name", "content"), [("box.stl", as_stl(BOX)), ("text.STL", TEXT), ("box.obj", OBJ)]
)
def test_every_kind_of_file_holds_the_same_box(tmp_path: Path, name: str, content: bytes | str):
    found = read_triangles(Path(written(tmp_path / name, content)), 0)
    volume = np.einsum("ij,ij->i", found[:, 0], np.cross(found[:, 1], found[:, 2])).sum() / 6
    assert found.shape == (12, 3, 3) and volume == pytest.approx(24)


def test_what_is_no_solid_is_told(tmp_path: Path):
    for name, content, words in (
        ("gone.stl", None, "is not there"),
        ("part.step", "ISO-10303", "needs the form FILE.stl or FILE.obj"),
        (
            "none.stl",
            as_stl(BOX[:0]),
            (
                "cannot be read .it has no faces with an area.;"
                " works: a part that is exported as triangles"
            ),
        ),
        ("flat.stl", as_stl(BOX[:, [0, 0, 1]]), r"cannot be read \(it has no faces with an area\)"),
        (
            "cut.stl",
            as_stl(BOX)[:-10],
            (
                r"cannot be read \(as a binary STL it should have 684 bytes, it has 674\);"
                r" works: an STL or OBJ file"
            ),
        ),
        (
            "nan.stl",
            as_stl(np.full_like(BOX, np.nan)),
            r"cannot be read \(it has corners that are not finite\)",
        ),
        ("points.obj", "v 0 0 0\nv 1 0 0\n", r"cannot be read \(it has no faces with an area\)"),
        ("bad.obj", "v 0 0 0\nf 1 2 x\n", "cannot be read"),
        ("beyond.obj", "v 0 0 0\nf 1 2 3\n", "cannot be read"),
    ):
        if content is not None:
            written(tmp_path / name, content)
        with pytest.raises(ParameterError, match=f"^file {words}"):
            solid(file=str(tmp_path / name), scale=0.1, at=((0, 0, 0),))


def test_the_nearest_point_is_in_a_face_on_an_edge_or_at_a_corner():
    for point, on in (
        ([1, 1, 5], [1, 1, 2]),
        ([2, -3, 4], [2, 0, 2]),
        ([9, 9, 9], [4, 3, 2]),
        ([3.5, 1, 1], [4, 1, 1]),
    ):
        np.testing.assert_allclose(nearest(BOX, np.array(point, float))[0], on, atol=1e-12)


def test_markers_lie_on_the_surface_and_face_outwards(tmp_path: Path):
    box = written(tmp_path / "box.stl", as_stl(BOX))
    target = solid(file=box, scale=0.1, at=((2, 1.5, 2.001), (4, 1.5, 1), (2, 0, 1)))
    np.testing.assert_allclose(
        target.points, [[0.2, 0.15, 0.2], [0.4, 0.15, 0.1], [0.2, 0, 0.1]], atol=1e-9
    )
    np.testing.assert_allclose(target.normals, [[0, 0, 1], [1, 0, 0], [0, -1, 0]], atol=1e-9)
    with pytest.raises(
        ParameterError,
        match=(
            r"at.1 must lie on the solid's surface: it is 50 mm off, nearest is \[2.0, 1.5, 2.0\]"
        ),
    ):
        solid(file=box, scale=0.1, at=((2, 1.5, 0), (2, 1.5, 2.5)))
    with pytest.raises(
        ParameterError,
        match=r"scale makes the solid 5.39e\+03 m large; give the metres of one unit of the file",
    ):
        solid(file=box, scale=1000, at=((2, 1.5, 0),))


def test_discs_belong_on_flat_places(tmp_path: Path):
    box = written(tmp_path / "box.stl", as_stl(BOX))
    edge = {"file": box, "scale": 0.1, "at": ((3.95, 1.5, 2),), "names": ("rim",)}
    with pytest.raises(
        ParameterError,
        match=(
            r"marker.radius does not fit at marker 0 \(rim\):"
            r" the surface is curved or ends there, 15 mm"
        ),
    ):
        solid(**edge, marker=Disc(radius=0.02))
    assert len(solid(**edge, marker=Sphere(radius=0.02)).points) == 1
    assert not solid(**edge, marker=Disc(radius=0.02), draw_markers=False).draw_markers
    with pytest.raises(ParameterError, match="marker"):
        solid(**edge, marker={"kind": "tag"})


def test_a_solid_hides_what_is_behind_it():
    target = solid(
        file=FLANGE,
        scale=0.001,
        at=((-100, 0, 18), (100, 0, 18), (0, 100, 18), (0, -100, 0)),
        marker=Disc(radius=0.01),
    )
    above = Pose(xyz=(0, 0, 1), rpy_deg=(180, 0, 0)).T
    # the last is on the back
    np.testing.assert_array_equal(target.hides(above), [False, False, False, True])
    aslant = Pose(xyz=(0.5, 0, 0.1)).T
    # the neck is before the first
    np.testing.assert_array_equal(target.hides(aslant), [True, False, False, True])
    assert not Square(side=0.2, pose=Pose()).hides(above).any()


class TestNames:
    def test_they_are_in_the_words_for_a_marker(self):
        target = Points(pose=Pose(), at=((0, 0, 0), (0.3, 0, 0)), names=("bolt", "left corner"))
        assert [target.called(i) for i in (0, 1)] == [
            "0 (bolt)",
            "1 (left corner)",
        ] and target.number("left corner") == 1
        assert (
            Points(pose=Pose(), at=((0, 0, 0),)).called(0) == "0"
            and target.number("nut") == -1
            and target.number(1) == 1
        )

    def test_each_marker_has_one_of_its_own(self):
        for names, words in (
            (("a",), "names must be 4 names, one for each marker, or none"),
            (("a", "b", "c", "a"), "names has a twice"),
            (("a", "b", "c", "3"), "names.3"),
        ):
            with pytest.raises(ParameterError, match=words):
                Square(side=0.4, pose=Pose(), names=names)
