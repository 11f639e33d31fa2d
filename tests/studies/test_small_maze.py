"""The small maze: what is trained in it; the training itself takes minutes and isn't repeated."""

import dataclasses

import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.config import codec
from eihrl_jax.mazes import paths
from eihrl_jax.reporting import cached_runs
from eihrl_jax.runs import policies
from eihrl_jax.studies import small_maze
from eihrl_jax.training import baselines


@pytest.mark.parametrize("method", small_maze.METHODS)
def test_each_method_can_be_trained_with_its_options(method, tmp_path):
    (tmp_path / "u5.txt").write_text(small_maze.MAZE)
    settings = small_maze.SmallConfig(out=tmp_path)
    options = small_maze.options_of(settings, method, 1)
    assert (options.method, options.seed, options.robot) == (method, 1, "point")
    assert options.run == tmp_path / f"{method}-u5-1"
    assert options.num_eval_episodes == 50
    # They survive the run folder, where a finished run is known by them.
    assert codec.from_json(type(options), codec.to_json(options)) == options
    arena = baselines.make_arena(options)
    assert arena.side_xy == (15, 15)


def test_only_the_way_round_leads_to_the_goal():
    maze = mazes.parse(small_maze.MAZE, name="u5")
    free = ~np.asarray(maze.wall)
    assert free[1:-1, 1:-1].sum() == 7
    distances = paths.distances(free, [(1, 1)])
    assert distances[3, 1] == 6


def fake(options):
    """Leaves what a training leaves, as far as it is looked at."""
    meta = {"num_steps": options.num_steps}
    policies.save(options.run / "policy", kind="baseline", params={}, meta=meta, overwrite=True)
    (options.run / "config.json").write_text(codec.to_json(options))
    (options.run / "metrics.csv").write_text("step,eval/success\n1,0.1\n2,\n3,0.98\n")


def test_a_finished_run_is_taken_as_it_is_and_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(baselines, "train", fake)
    settings = small_maze.SmallConfig(methods=("hess", "hiro"), seeds=(2,), out=tmp_path)
    small_maze.main(settings)
    told = capsys.readouterr().out.splitlines()
    assert told == ["hiro, seed 2: 98% after 150,000", "hess, seed 2: 98% after 200,000"]

    monkeypatch.setattr(baselines, "train", lambda options: pytest.fail("trained again"))
    small_maze.main(settings)


def test_a_run_that_was_extended_and_killed_is_not_finished(tmp_path):
    settings = small_maze.SmallConfig(out=tmp_path)
    options = small_maze.options_of(settings, "hiro", 0)
    cached_runs.finish(options, fake)
    extended = dataclasses.replace(options, num_steps=options.num_steps + 1)
    # A training that goes on says so in the folder first; its policy is still the old one.
    (options.run / "config.json").write_text(codec.to_json(extended))
    assert not cached_runs.is_finished(extended)
    cached_runs.finish(extended, fake)
    assert cached_runs.is_finished(extended)


def test_another_maze_of_that_name_is_not_overwritten(tmp_path):
    maze = tmp_path / "u5.txt"
    maze.write_text("####\n#1S#\n####\n")
    with pytest.raises(base.UserError, match=r"u5.txt is another maze than is trained in"):
        small_maze.main(small_maze.SmallConfig(out=tmp_path))
    assert maze.read_text() == "####\n#1S#\n####\n"


@pytest.mark.parametrize(
    ("name", "value"), [("methods", ("droq",)), ("seeds", (-1,)), ("methods", ())]
)
def test_bad_options_are_named(name, value):
    with pytest.raises(base.UserError, match=name):
        dataclasses.replace(small_maze.SmallConfig(), **{name: value})
