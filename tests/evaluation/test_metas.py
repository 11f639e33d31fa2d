"""Folders of policies that are whole and make no sense are refused in one line."""

import copy
import json

import jax.numpy as jnp
import pytest

from eihrl_jax import base, robots
from eihrl_jax.evaluation import loading
from eihrl_jax.runs import checkpoint, policies

LOADS = {
    "best-random-0": ("high", loading.load_high),
    "point": ("low", lambda path: loading.load_low(path, robots.load("point"))),
}


def load_changed(name, change, path):
    """Loads a shipped policy whose meta.json has been changed, under right checksums."""
    kind, load = LOADS[name]
    params, meta = policies.load(policies.find(name, kind), kind=kind)
    meta = {"kind": kind, **copy.deepcopy(meta)}
    change(meta)
    checkpoint.write(path, {"params": params}, files={"meta.json": json.dumps(meta)})
    return load(str(path))


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("best-random-0", {"kind": None}, "names no kind of policy"),
        ("best-random-0", {"kind": ["high"]}, "names no kind of policy"),
        ("best-random-0", {"view": None}, "view = None must be an object"),
        ("best-random-0", {"view": {"pixels": 1e308}}, "pixels = 1e.308 must be int"),
        ("best-random-0", {"view": {"pixels": 10**30}}, "an integer is beyond"),
        ("best-random-0", {"network": {"kind": "patch"}}, "must be one of|describes no network"),
        ("best-random-0", {"movement": 3}, "3 must be an object"),
        ("best-random-0", {"movement": {"anchored": 1}}, "anchored = 1 must be bool"),
        ("best-random-0", {"greedy": "yes"}, "greedy = 'yes' must be bool"),
        ("point", {"hidden": 3}, "hidden = 3 must be a list"),
        ("point", {"hidden": [-1]}, "hidden"),
        ("point", {"hidden": [16, 16]}, "holds another network or state"),
        ("point", {"low_input": {"a": 1}}, "unknown option 'a'"),
        ("point", {"num_actions": 2**62}, "num_actions = .* at most"),
        ("point", {"robot": {}}, "is a policy of robot"),
    ],
)
def test_odd_descriptions_are_refused(tmp_path, name, changes, message):
    with pytest.raises(base.UserError, match=message) as error:
        load_changed(name, lambda meta: meta.update(changes), tmp_path / "odd")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("entry", ["view", "network"])
def test_missing_entries_are_named(tmp_path, entry):
    with pytest.raises(base.UserError, match=f"meta.json lacks '{entry}'"):
        load_changed("best-random-0", lambda meta: meta.pop(entry), tmp_path / "odd")


def test_more_entries_are_no_fault(tmp_path):
    high = load_changed("best-random-0", lambda meta: meta.update(note="mine"), tmp_path / "more")
    assert high.anchored and high.view.map_radius == 8


def test_parameters_that_are_no_numbers_are_refused(tmp_path):
    params, meta = policies.load(policies.find("point", "low"), kind="low")
    broken = {**params, "Dense_0": {**params["Dense_0"], "bias": jnp.full(3, jnp.nan)}}
    policies.save(tmp_path / "nan", kind="low", params=broken, meta=meta)
    with pytest.raises(base.UserError, match="Dense_0/bias holds numbers that aren't finite"):
        policies.load(tmp_path / "nan", kind="low")
