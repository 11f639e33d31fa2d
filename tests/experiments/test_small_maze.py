"""The small maze: what is trained in it; the training itself takes minutes and isn't repeated."""

import dataclasses

import numpy as np
import pytest

from eihrl_jax import base, config, mazes
from eihrl_jax.mazes import paths
from eihrl_jax.training import baselines
from experiments import small_maze


@pytest.mark.parametrize("method", small_maze.METHODS)
def test_each_method_can_be_trained_with_its_options(method, tmp_path):
    (tmp_path / "u5.txt").write_text(small_maze.MAZE)
    settings = small_maze.SmallConfig(out=tmp_path)
    options = small_maze.options_of(settings, method, 1)
    assert (options.method, options.seed, options.robot) == (method, 1, "point")
    assert options.run == tmp_path / f"{method}-u5-1"
    assert options.num_eval_episodes == 50
    # They survive the run folder, where a finished run is known by them.
    assert config.from_json(type(options), config.to_json(options)) == options
    arena = baselines.make_arena(options)
    assert arena.side_xy == (15, 15)


def test_only_the_way_round_leads_to_the_goal():
    maze = mazes.parse(small_maze.MAZE, name="u5")
    free = ~np.asarray(maze.wall)
    assert free[1:-1, 1:-1].sum() == 7
    distances = paths.distances(free, [(1, 1)])
    assert distances[3, 1] == 6


def test_a_finished_run_is_taken_as_it_is_and_told(tmp_path, monkeypatch, capsys):
    def fake(options):
        (options.run / "policy").mkdir(parents=True)
        (options.run / "config.json").write_text(config.to_json(options))
        (options.run / "metrics.csv").write_text("step,eval/success\n1,0.1\n2,\n3,0.98\n")

    monkeypatch.setattr(baselines, "train", fake)
    settings = small_maze.SmallConfig(methods=("hess", "hiro"), seeds=(2,), out=tmp_path)
    small_maze.main(settings)
    told = capsys.readouterr().out.splitlines()
    assert told == ["hiro, seed 2: 98% after 60,000", "hess, seed 2: 98% after 200,000"]

    monkeypatch.setattr(baselines, "train", lambda options: pytest.fail("trained again"))
    small_maze.main(settings)


@pytest.mark.parametrize(
    ("name", "value"), [("methods", ("droq",)), ("seeds", (-1,)), ("methods", ())]
)
def test_bad_options_are_named(name, value):
    with pytest.raises(base.UserError, match=name):
        dataclasses.replace(small_maze.SmallConfig(), **{name: value})
