"""A final policy says what it is, and nothing else is taken for it."""

import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.runs import policies

PARAMS = {"actor": {"dense": {"kernel": jnp.ones((3, 4)), "bias": jnp.zeros(4)}}}


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "run" / policies.FOLDER
    policies.save(path, kind="low", params=PARAMS, meta={"robot": "ant", "widths": [4]})
    return path


def test_round_trip(saved):
    params, meta = policies.load(saved, kind="low", robot="ant")
    np.testing.assert_array_equal(params["actor"]["dense"]["kernel"], 1.0)
    assert meta == {"kind": "low", "robot": "ant", "widths": [4]}


def test_other_level_and_robot_are_refused(saved):
    with pytest.raises(base.UserError, match="is a low-level policy, expected a high-level"):
        policies.load(saved, kind="high")
    with pytest.raises(base.UserError, match="of robot 'ant', expected 'point'"):
        policies.load(saved, kind="low", robot="point")


def test_a_missing_entry_is_named(saved):
    _, meta = policies.load(saved, kind="low")
    assert policies.entry(meta, "widths", saved) == [4]
    with pytest.raises(base.UserError, match=r"meta\.json lacks 'view'"):
        policies.entry(meta, "view", saved)


@pytest.mark.parametrize("name", ["meta.json", "manifest.json"])
def test_damage_is_found(saved, name):
    file = saved / name
    file.write_bytes(file.read_bytes()[:-5])
    with pytest.raises(base.UserError, match=f"is damaged: {name}"):
        policies.load(saved, kind="low")


def test_existing_policy_is_overwritten_only_on_demand(saved):
    with pytest.raises(base.UserError, match="is not overwritten"):
        policies.save(saved, kind="high", params=PARAMS, meta={})
    policies.save(saved, kind="high", params=PARAMS, meta={}, overwrite=True)
    assert policies.load(saved, kind="high")[1] == {"kind": "high"}


def test_low_level_policy_needs_a_robot(tmp_path):
    with pytest.raises(ValueError, match="robot"):
        policies.save(tmp_path / "x", kind="low", params=PARAMS, meta={})


def test_find_takes_policy_run_and_shipped_name(saved, monkeypatch, tmp_path):
    assert policies.find(saved, "low") == saved
    assert policies.find(saved.parent, "low") == saved
    monkeypatch.setattr(policies, "PRETRAINED", tmp_path / "pretrained")
    shipped = tmp_path / "pretrained" / "ant" / "low"
    policies.save(shipped, kind="low", params=PARAMS, meta={"robot": "ant"})
    assert policies.find("ant", "low") == shipped
    assert policies.shipped("low") == ["ant"]
    assert policies.kind_of("ant") == policies.kind_of(saved) == "low"
    assert policies.kind_of("walrus") is None
    with pytest.raises(
        base.UserError, match=r"walrus is neither .* shipped low-level policy names: ant"
    ):
        policies.find("walrus", "low")


def test_unfinished_run_is_told(tmp_path):
    (tmp_path / "config.json").write_text("{}")
    with pytest.raises(base.UserError, match="training has just begun"):
        policies.find(tmp_path, "high")
