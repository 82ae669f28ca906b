"""Files that a model names are regular before MuJoCo opens them: of a pipe it would wait for ever."""

import os

import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.sim.scene.model_files import read_model

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
    file.write_text(f'<robot name="r"><link name="base"><collision>{shape}</collision></link></robot>')
    with pytest.raises(ParameterError, match=r"pipe\.stl, which is not a regular file"):
        read_model(file)
