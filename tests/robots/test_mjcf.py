"""MJCF files of strangers lead nowhere out of their folder, and keep nobody waiting."""

import os

import pytest

from eihrl_jax import base
from eihrl_jax.robots import mjcf

BODY = '<worldbody><body><freejoint/><geom size="0.1"/></body></worldbody>'


def write(path, inside):
    path.write_text(f"<mujoco>{inside}{BODY}</mujoco>")
    return path


@pytest.mark.parametrize(
    "inside",
    [
        '<include file="../secret.xml"/>',
        '<include file="&#46;&#x2E;/secret.xml"/>',
        r'<include file="..\secret.xml"/>',
        "<include file='/etc/passwd'/>",
        '<compiler meshdir="../elsewhere"/>',
        '<asset><texture name="t" type="skybox" fileright="/dev/zero"/></asset>',
        '<asset><mesh name="m" file="a/../../m.stl"/></asset>',
    ],
)
def test_what_leads_out_of_the_folder_is_refused(tmp_path, inside):
    write(tmp_path / "secret.xml", "")
    (tmp_path / "robot").mkdir()
    with pytest.raises(base.UserError, match=r"it names '.*': what belongs to a robot lies in"):
        mjcf.load(write(tmp_path / "robot" / "a.xml", inside))


def test_nobody_waits_for_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(base.UserError, match="pipe is no regular file"):
        mjcf.load(tmp_path / "pipe")
    (tmp_path / "meshes").mkdir()
    os.mkfifo(tmp_path / "meshes" / "m.stl")
    inside = '<compiler meshdir="meshes"/><asset><mesh name="m" file="m.stl"/></asset>'
    with pytest.raises(base.UserError, match=r"it names 'm.stl', which is no file to be read"):
        mjcf.load(write(tmp_path / "a.xml", inside))


def test_files_that_are_included_are_looked_at_too(tmp_path):
    (tmp_path / "parts").mkdir()
    part = tmp_path / "parts" / "b.xml"
    part.write_text('<mujocoinclude><include file="../../c.xml"/></mujocoinclude>')
    with pytest.raises(base.UserError, match=r"it names '../../c.xml'"):
        mjcf.load(write(tmp_path / "a.xml", '<include file="parts/b.xml"/>'))
    part.write_text("<mujocoinclude><option/></mujocoinclude>")
    spec = mjcf.load(write(tmp_path / "a.xml", '<include file="parts/b.xml"/>'))
    assert len(spec.bodies) == 2


def test_entities_are_not_expanded(tmp_path):
    text = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 20}">' for i in range(1, 20))
    path = tmp_path / "a.xml"
    path.write_text(f'<!DOCTYPE x [<!ENTITY e0 "ha">{text}]><mujoco model="&e19;">{BODY}</mujoco>')
    try:
        assert len(mjcf.load(path).modelname) < 100
    except ValueError as error:
        assert len(str(error)) < 1_000
