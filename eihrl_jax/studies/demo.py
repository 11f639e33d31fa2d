"""The main job in one command: train the high level, then evaluate the hierarchy in four mazes."""

import dataclasses
import itertools
import pathlib

from eihrl_jax import base
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import limits, presets
from eihrl_jax.evaluation import tables
from eihrl_jax.reporting import evaluations, trainers


@limits.dataclass
class DemoConfig:
    """Trains the high level on the Random Square with oracle movement, then tests it unchanged.

    The tests are Table 1 of the paper: the Random Square and Maze-g1 to g3, with oracle movement
    and with the ant really walking.

    Attributes:
      run: folder of the results, must be new; default: the first free one of runs/demo, demo-2, ...
      episodes: per maze and movement.
      seed: of training and evaluation.
    """

    run: pathlib.Path | None = None
    episodes: limits.UpToMillion = 500
    seed: limits.Seed = 0


def main(config: DemoConfig) -> None:
    """Trains, evaluates, prints Table 1 and where the pictures are."""
    run = _new_folder(config.run)

    trained = run / "high"
    trainers.train_high(dataclasses.replace(presets.high_best(), run=trained, seed=config.seed))

    # The paper's Table 1, which are the options' defaults.
    evaluation = evaluations.evaluate(
        evaluate_config.EvaluateConfig(
            high=(str(trained),),
            episodes=config.episodes,
            seeds=(config.seed,),
            out=run / "evaluation",
        )
    )
    tables.show(tables.terminal(evaluation.cells))

    print("\nPictures:")
    for picture in sorted((*run.rglob("*.png"), *run.rglob("*.gif"))):
        print(f"  {picture}")


def _new_folder(wanted: pathlib.Path | None) -> pathlib.Path:
    """Returns the folder to fill, one that doesn't exist yet.

    Raises:
      base.UserError: the folder that was asked for exists.
    """
    if wanted is None:
        names = itertools.chain(["demo"], (f"demo-{i}" for i in itertools.count(2)))
        return next(path for name in names if not (path := pathlib.Path("runs", name)).exists())
    if wanted.exists():
        raise base.UserError(f"run = {wanted} exists already; name a new folder")
    return wanted
