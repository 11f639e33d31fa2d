"""Hostile files of every kind, by the ways users read them: one line each, and nothing is executed.

`docs/security.md` says what is read of strangers. Each file here would leave the file `executed`,
take what stands in `secret`, or fill the memory.
"""

import hashlib
import io
import json
import pathlib
import pickle
import shutil

import numpy as np
import pytest

from eihrl_jax import base, mazes, robots
from eihrl_jax.config import high as high_config
from eihrl_jax.datasets import parts
from eihrl_jax.envs import postures
from eihrl_jax.evaluation import loading, results
from eihrl_jax.physics import scene
from eihrl_jax.runs import policies, run_folder
from eihrl_jax.storage import archives

SECRET = "of-nobody-else"
DESCRIPTION = """
name = "mine"
mjcf = "a.xml"
root = "free"
physics_step = 0.01
num_substeps = 5
steps_per_subgoal = 10
reach = 0.5
body_radius = 0.5
"""


class Executed:
    """Its pickle leaves a file where a test looks for it."""

    def __init__(self, folder):
        self.path = folder / "executed"

    def __reduce__(self):
        return pathlib.Path.touch, (self.path,)


@pytest.fixture
def folder(tmp_path):
    """A folder beside the canary and the secret; neither may have been touched in the end."""
    (tmp_path / "secret.xml").write_text(f'<mujocoinclude><default class="{SECRET}"/>')
    inside = tmp_path / "inside"
    inside.mkdir()
    yield inside
    assert sorted(path.name for path in tmp_path.iterdir()) == ["inside", "secret.xml"]


def objects(folder):
    return np.array([Executed(folder.parent)], dtype=object)


def odd_maze(folder, data):
    (folder / "maze").write_bytes(data)
    mazes.load(folder / "maze")


def array_of_objects(folder):
    stream = io.BytesIO()
    np.save(stream, objects(folder), allow_pickle=True)
    odd_maze(folder, stream.getvalue())


def odd_robot(folder, inside):
    model = f'<worldbody><body><freejoint/><geom size="0.1"/></body></worldbody>{inside}'
    (folder / "a.xml").write_text(f"<mujoco>{model}</mujoco>")
    (folder / "mine.toml").write_text(DESCRIPTION)
    scene.build(robots.load(str(folder / "mine.toml")))


def odd_description(folder, text):
    (folder / "mine.toml").write_text(text)
    robots.load(str(folder / "mine.toml"))


def odd_run(folder, config):
    (folder / "config.json").write_text(config)
    run_folder.RunFolder.create(folder, high_config.HighConfig(), resume=True)


def odd_policy(folder, change):
    """Changes a shipped policy, and makes its checksums right again."""
    path = folder / "policy"
    shutil.copytree(policies.find("point", "low"), path)
    manifest = json.loads((path / "manifest.json").read_text())
    change(path, manifest)
    manifest["files"] = {
        name: hashlib.sha256((path / name).read_bytes()).hexdigest()
        for name in manifest["files"]
        if (path / name).is_file()
    }
    (path / "manifest.json").write_text(json.dumps(manifest))
    loading.load_low(str(path), robots.load("point"))


def pickled_arrays(path, manifest):
    del manifest
    for file in (path / "arrays").rglob("*"):
        if file.is_file():
            file.write_bytes(pickle.dumps(Executed(path.parents[1])))


def pickle_beside(path, manifest):
    del manifest
    (path / "params.pkl").write_bytes(pickle.dumps(Executed(path.parents[1])))


def announced(kind, name=None):
    """Changes what the manifest says of an array."""

    def change(path, manifest):
        del path
        manifest["arrays"][name or next(iter(manifest["arrays"]))] = kind

    return change


def name_elsewhere(path, manifest):
    del path
    manifest["files"]["../../secret.xml"] = "0" * 64


def odd_bank(folder):
    archives.write(folder / "a", {"robot": np.array("ant"), "qpos": objects(folder)})
    postures.load(folder / "a", robots.load("ant"))


def odd_part(folder):
    archives.write(folder / "a", {"lengths": objects(folder), "seed": np.array(0)})
    list(parts.read(folder / "a", 0))


def odd_results(folder, text):
    (folder / "eval.json").write_text(text)
    results.load(folder / "eval.json")


CODE = "__import__('pathlib').Path('executed').touch()"
TAG = "!!python/object/apply:pathlib.Path.touch [executed]"

HOSTILE = {
    "maze: an array of objects": array_of_objects,
    "maze: a pickle": lambda folder: odd_maze(folder, pickle.dumps(Executed(folder.parent))),
    "map: a tag of YAML": lambda folder: odd_maze(folder, f"image: {TAG}\n".encode()),
    "robot: a file elsewhere": lambda folder: odd_robot(
        folder, '<include file="&#46;&#46;/secret.xml"/>'
    ),
    "robot: a plugin": lambda folder: odd_robot(
        folder, '<extension><plugin plugin="../executed.so"/></extension>'
    ),
    "robot: code in a description": lambda folder: odd_description(folder, f"name = {CODE}"),
    "config: code": lambda folder: odd_run(folder, json.dumps({"seed": CODE})),
    "config: another type": lambda folder: odd_run(folder, '{"py/object": "pathlib.Path"}'),
    "policy: pickles as arrays": lambda folder: odd_policy(folder, pickled_arrays),
    "policy: a pickle beside": lambda folder: odd_policy(folder, pickle_beside),
    "policy: an array of 4 TB": lambda folder: odd_policy(
        folder, announced("float32[1000000,1000000]")
    ),
    "policy: another shape": lambda folder: odd_policy(folder, announced("float32[3,3]")),
    "policy: no shape": lambda folder: odd_policy(folder, announced("float32[-3,x]")),
    "policy: no type": lambda folder: odd_policy(folder, announced("object[1]")),
    "policy: an array in another": lambda folder: odd_policy(
        folder, announced("float32[1]", "params/Dense_0/bias/x")
    ),
    "policy: an array very deep": lambda folder: odd_policy(
        folder, announced("float32[1]", "a/" * 5_000 + "b")
    ),
    "policy: a file elsewhere": lambda folder: odd_policy(folder, name_elsewhere),
    "postures: objects": odd_bank,
    "dataset: objects": odd_part,
    "results: code": lambda folder: odd_results(folder, json.dumps({"cells": CODE})),
}


def test_the_canary_sings(tmp_path):
    pickle.loads(pickle.dumps(Executed(tmp_path)))
    assert (tmp_path / "executed").exists()


# Orbax leaves tasks behind where it fails.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("read", HOSTILE.values(), ids=HOSTILE.keys())
def test_what_is_hostile_is_refused_in_one_line(folder, read, monkeypatch):
    monkeypatch.chdir(folder.parent)
    with pytest.raises(base.UserError) as refused:
        read(folder)
    message = str(refused.value)
    assert 0 < len(message) < 1_000 and "\n" not in message and SECRET not in message
