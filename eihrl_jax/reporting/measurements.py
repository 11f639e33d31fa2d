"""Folder of a low level's measurement: its figures, where its subgoals ended, its postures."""

import json

from eihrl_jax.config import measure as measure_config
from eihrl_jax.drawing import figures, scatter
from eihrl_jax.envs import end_points, postures, subgoals
from eihrl_jax.evaluation import ends as ends_lib
from eihrl_jax.evaluation import measure as measure_lib
from eihrl_jax.runs import folders, versions
from eihrl_jax.storage import writing


def measure(options: measure_config.MeasureConfig) -> measure_lib.Measurement:
    """Measures a low level and fills its folder.

    Args:
      options: whose, and how long.

    Returns:
      The figures.

    Raises:
      base.UserError: the folder isn't free; robot or policy is unknown or doesn't fit; the robot
        was never upright.
    """
    with folders.reserved(options.out):
        measured = measure_lib.run(options)
        _write(measured, options)
    return measured


def _write(measured: measure_lib.Measurement, options: measure_config.MeasureConfig) -> None:
    """Writes figures, picture and posture bank."""
    robot = measured.robot
    # Surroundings at the top level, where `subgoals.load` looks for them.
    document = {name: vars(statistics) for name, statistics in measured.statistics.items()}
    drift = {subgoals.DRIFT: [vars(drift) for drift in measured.drift]}
    standing = {} if measured.standing is None else {"standing": vars(measured.standing)}
    about = {"robot": robot.name, "low": options.low or options.robot, "sigma": options.sigma}
    text = json.dumps(
        document | drift | standing | about | {"versions": versions.describe()}, indent=2
    )
    writing.write_text(options.out / subgoals.FILE, text + "\n")

    # Beside the figures, so that the high level can be trained with both, see `subgoals.gait`.
    bank = measured.postures(options.num_postures)
    postures.save(bank, options.out / subgoals.POSTURES, robot)

    # For `predict`: in corridors subgoals are anchored, as in a maze; on open floor they aren't.
    laws = ends_lib.law(measured.corridors), ends_lib.law(measured.steps)
    end_points.save(options.out / end_points.FILE, robot.name, *laws)

    # Of open floor: among walls the ends say as much about the rooms.
    path, ends = options.out / "subgoals.png", ends_lib.by_direction(measured.steps)
    title = f"{robot.name}, {subgoals.OPEN}"
    figures.attempt(path, lambda: scatter.save(path, ends, title, options.sigma))
