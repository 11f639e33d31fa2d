"""Folder of a robot's trial: its description, and a picture of it in its cell."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from eihrl_jax import base, robots
from eihrl_jax.config import robot as robot_config
from eihrl_jax.drawing import figures, robot_views
from eihrl_jax.physics import kinematics, proposal, scene, trials
from eihrl_jax.robots import files
from eihrl_jax.runs import folders
from eihrl_jax.storage import writing


@dataclasses.dataclass(frozen=True)
class Trial:
    """The results of trying a robot.

    Attributes:
      description: text of the description that was tried out.
      size: what its model holds, in a line.
      seconds_upright: for which it stays in its healthy heights without control.
      faults: what a simulation says against it, each in a line.
    """

    description: str
    size: str
    seconds_upright: float
    faults: list[str]


def try_out(options: robot_config.RobotConfig) -> Trial:
    """Tries a robot out and fills its folder.

    Args:
      options: whose file.

    Returns:
      What was found out.

    Raises:
      base.UserError: the folder isn't free, or no robot can be made of the file.
    """
    is_description = options.file.suffix == files.SUFFIX
    robot = robots.load(str(options.file)) if is_description else proposal.propose(options.file)
    model = scene.build(robot)
    with folders.reserved(options.out):
        description = files.text(robot, options.out)
        # What is given stays where it is, comments and all.
        if not is_description:
            writing.write_text(options.out / f"robot{files.SUFFIX}", description)

        qpos = jnp.asarray(model.key_qpos[0], jnp.float32)
        capsules = jax.tree.map(np.asarray, kinematics.capsules(model)(qpos))
        title = f"{robot.name} in a cell of {robot.cell:g} m"
        path = options.out / "robot.png"
        figures.attempt(path, lambda: robot_views.save(path, capsules, robot.cell, title))

    upright = trials.seconds_upright(model, robot)
    return Trial(description, trials.size(model), upright, trials.faults(model, robot))


def summary(trial: Trial) -> str:
    """Returns a trial's description, and beside it what isn't a fault, as comments."""
    lines = [trial.description.rstrip(), f"# {trial.size}"]
    if trial.seconds_upright < trials.AT_REST:
        lines.append(f"# without control it leaves healthy_z after {trial.seconds_upright:.1f} s")
    return "\n".join(lines)


def check(trial: Trial) -> None:
    """Raises all faults of a trial at once.

    Raises:
      base.UserError: there are some.
    """
    if trial.faults:
        raise base.UserError("; ".join(trial.faults))
