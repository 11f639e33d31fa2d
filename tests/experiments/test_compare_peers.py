"""The comparison of the peers: which runs it makes, with which options."""

import pytest

from eihrl_jax import base
from eihrl_jax.config import baselines as baselines_config
from experiments import compare_peers


@pytest.mark.parametrize("method", ["droq", "higl", "hrac", "hiro", "hess"])
def test_runs_are_named_as_the_report_finds_them_and_share_the_budget(method, tmp_path):
    config = compare_peers.CompareConfig(methods=(method,), num_steps=50_000, out=tmp_path)
    options = compare_peers.options_of(config, method, "u", "dense", 2)
    assert isinstance(options, baselines_config.BaselineConfig)
    assert options.run == tmp_path / f"{method}-u-dense-2"
    assert (options.method, options.maze, options.reward) == (method, "u", "dense")
    assert (options.seed, options.num_steps, options.resume) == (2, 50_000, True)
    sparse = compare_peers.options_of(config, method, "s", "sparse", 0)
    assert sparse.run == tmp_path / f"{method}-s-0"


@pytest.mark.parametrize(
    ("name", "value"),
    [("methods", ("sarsa",)), ("mazes", ("moon",)), ("seeds", ()), ("num_steps", 0)],
)
def test_bad_options_are_named(name, value):
    with pytest.raises(base.UserError, match=name):
        compare_peers.CompareConfig(**{name: value})
