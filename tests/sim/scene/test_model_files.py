"""Files that a model names are regular before MuJoCo opens them:
of a pipe it would wait for ever.
"""

import os

import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.sim.scene.model_files import check_options, read_model

BODY = '<worldbody><body><joint/><geom size=".1"/></body></worldbody>'
NAMING = {
    "mesh": '<asset><mesh name="m" file="pipe"/></asset>',
    "texture": '<asset><texture name="t" type="2d" file="pipe"/></asset>',
    "face": '<asset><texture name="t" type="cube" fileright="pipe"/></asset>',
    "hfield": '<asset><hfield name="h" file="pipe" size="1 1 1 1"/></asset>',
    "skin": '<deformable><skin name="s" file="pipe"/></deformable>',
    "include": '<include file="pipe"/>',
    "model": '<asset><model name="m" file="pipe"/></asset>',
}


@pytest.mark.parametrize("what", NAMING)
def test_a_pipe_that_a_model_names_is_refused_by_name(tmp_path, what):
    os.mkfifo(tmp_path / "pipe.stl")
    file = tmp_path / "arm.xml"
    file.write_text(f"<mujoco>{NAMING[what].replace('pipe', 'pipe.stl')}{BODY}</mujoco>")
    with pytest.raises(ParameterError, match=r"pipe\.stl, which is not a regular file"):
        read_model(file)


def test_a_pipe_that_a_urdf_names_is_refused_by_name(tmp_path):
    os.mkfifo(tmp_path / "pipe.stl")
    file = tmp_path / "arm.urdf"
    shape = '<geometry><mesh filename="pipe.stl"/></geometry>'
    file.write_text(
        f'<robot name="r"><link name="base"><collision>{shape}</collision></link></robot>'
    )
    with pytest.raises(ParameterError, match=r"pipe\.stl, which is not a regular file"):
        read_model(file)


HUGE = {
    "a texture": (
        '<asset><texture name="a>b" type="2d" builtin="flat" width="60000" height="60000"/></asset>'
    ),
    "a height field": '<asset><hfield name="h" nrow="50000" ncol="50000" size="1 1 1 1"/></asset>',
    "copies": '<worldbody><replicate count="300000"><geom size=".1"/></replicate></worldbody>',
    "copies of copies": (
        "<worldbody><replicate count='300'><replicate count='300'><geom size='.1'/></replicate>"
        "</replicate></worldbody>"
    ),
    "a grid": (
        '<worldbody><flexcomp name="f" type="grid" count="200 200 200" spacing="1 1 1"/>'
        "</worldbody>"
    ),
    "memory": '<size memory="100G"/>',
    "numbers for users": '<size nuserdata="100000000000"/>',
}


@pytest.mark.parametrize("what", HUGE)
@pytest.mark.parametrize("included", [False, True])
def test_more_than_a_machine_has_is_refused_before_mujoco_makes_it(tmp_path, what, included):
    """Of these it makes 20 GB, or copies for minutes, during which it takes no signal."""
    file = tmp_path / "arm.xml"
    part = tmp_path / "part.xml" if included else file
    part.write_text(f"<mujoco>{HUGE[what]}{BODY}</mujoco>")
    if included:
        file.write_text('<mujoco><include file="part.xml"/></mujoco>')
    with pytest.raises(
        ParameterError, match=rf"asks for .* are made; make it smaller, got '{part}"
    ):
        read_model(file)


def test_as_much_as_robots_have_is_read_and_a_number_in_other_letters_is_refused(tmp_path):
    file = tmp_path / "arm.xml"
    many = "<replicate count='99'><geom size='.1'/></replicate>" * 3  # beside one another
    file.write_text(
        f'<mujoco><size memory="64M"/><worldbody><body><joint/>{many}</body></worldbody></mujoco>'
    )
    assert read_model(file).compile().ngeom == 297
    file.write_text(
        '<mujoco><asset><texture name="t" builtin="flat" width="&#54;0000" height="1"/>'
        f"</asset>{BODY}</mujoco>"
    )
    with pytest.raises(ParameterError, match="numbers that say how much there is"):
        read_model(file)


@pytest.mark.parametrize(
    "option", ['wind="3 0 0"', 'gravity="0 0 -1"', "gravity", "contact", "limit", "override"]
)
def test_an_option_that_a_scene_would_lose_is_refused_by_name(tmp_path, option):
    file = tmp_path / "arm.xml"
    flag = f'<flag {option}="{"enable" if option == "override" else "disable"}"/>'
    file.write_text(
        f"<mujoco><option {option}/>{BODY}</mujoco>"
        if "=" in option
        else f"<mujoco><option>{flag}</option>{BODY}</mujoco>"
    )
    name = option.partition("=")[0] if "=" in option else f"flag {option}"
    with pytest.raises(ParameterError, match=rf"sets the option {name}, which is not taken over"):
        check_options(read_model(file), file)
    file.write_text(
        '<mujoco><option integrator="RK4" o_margin="1"><flag warmstart="disable"/>'
        f"</option>{BODY}</mujoco>"
    )
    check_options(read_model(file), file)
