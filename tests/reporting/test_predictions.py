"""Folder of a prediction beside an evaluation, and what can't be predicted."""

import json
import pathlib

import pytest

from eihrl_jax import base
from eihrl_jax.config import predict as predict_config
from eihrl_jax.evaluation import results, statistics
from eihrl_jax.reporting import predictions

MAZE = "decisions 5\n######\n#S..1#\n######\n"


def _evaluation(folder, maze, rate):
    """What walked three moves to the goal, in as many decisions."""
    success = statistics.Success(rate=rate, low=rate - 0.1, high=rate, block_std=None)
    cell = results.Cell(
        maze=str(maze),
        agent=results.Agent(robot="point", movement="full", high="shortest", low="point"),
        seeds=(0,),
        num_episodes=20,
        num_goals=1,
        num_decisions=5,
        success=success,
        seed_rates=(rate,),
        return_mean=rate,
        decisions_mean=3.0,
        decisions_solved=3.0,
        num_falls=0,
        outcomes=results.Outcomes(solved=20, fallen=0, unstable=0, late=0),
    )
    folder.mkdir()
    results.save(folder / "eval.json", results.Evaluation(cells=(cell,)))


def test_what_walked_stands_beside_what_was_predicted(tmp_path):
    maze = tmp_path / "maze.txt"
    maze.write_text(MAZE)
    _evaluation(tmp_path / "walked", maze, 0.95)
    options = predict_config.PredictConfig(walked=(tmp_path / "walked",), out=tmp_path / "out")
    (row,) = predictions.predict(options)
    # A point hardly ever misses: always there in three.
    assert row.predicted.success == pytest.approx(1.0, abs=1e-3)
    assert row.predicted.decisions == pytest.approx(3.0, abs=1e-2)
    assert not row.is_close and row.anchored
    (kept,) = json.loads((tmp_path / "out" / "prediction.json").read_text())["rows"]
    assert kept["walked"]["success"]["rate"] == 0.95
    assert (tmp_path / "out" / "prediction.png").read_bytes()[:4] == b"\x89PNG"
    assert "| 100.0 | 95.0 | 3.0 | 3.0 | 0 |" in (tmp_path / "out" / "prediction.md").read_text()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"robot": ("docs/robots/cart.toml",)}, "no end points are shipped for robot"),
        ({"walked": (pathlib.Path("nowhere"),)}, "nowhere/eval.json can't be read"),
    ],
)
def test_what_cannot_be_predicted_gets_one_line(tmp_path, options, said):
    with pytest.raises(base.UserError, match=said):
        predictions.predict(predict_config.PredictConfig(**options, out=tmp_path / "out"))
