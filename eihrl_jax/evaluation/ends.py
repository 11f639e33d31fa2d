"""End points of a measured low level: by direction, and by condition."""

import numpy as np
from jaxtyping import Float

from eihrl_jax import base
from eihrl_jax.envs import end_points
from eihrl_jax.evaluation import steps as steps_lib


def by_direction(steps: steps_lib.Steps) -> dict[int, Float[np.ndarray, "S 2"]]:
    """Returns displacements in the world's frame by direction, of subgoals begun clear, units."""
    counted = steps_lib.counts(steps)
    along_lateral = np.stack([steps.along[counted], steps.lateral[counted]], -1)
    direction = np.asarray(steps.direction)[counted]

    # From the subgoal's frame back to the world's, where the four directions part.
    ends = {}
    for index, (x, y) in enumerate(base.DIRECTIONS_XY):
        to_world = np.array([[x, y], [-y, x]])  # rows: where `along` and `lateral` point
        ends[index] = along_lateral[direction == index] @ to_world
    return ends


def law(steps: steps_lib.Steps) -> end_points.EndPoints:
    """Returns the end points of all subgoals without a wall in the way, falls included.

    Args:
      steps: on the host.
    """
    turns, rows = end_points.turns(), []
    for robot in range(steps.switched.shape[1]):
        before, condition = -1, end_points.REST
        for t in np.flatnonzero(steps.switched[:, robot] > 0):
            # The first subgoal of an episode follows none, nor does one after lying down.
            is_down = not steps.start.is_upright[t, robot]
            is_first = before < 0 or steps.ended[before:t, robot].any()
            if is_down:
                condition = end_points.DOWN
            elif is_first or condition == end_points.DOWN:
                condition = end_points.REST
            else:
                condition = turns[steps.direction[before, robot], steps.direction[t, robot]]

            before = t
            if steps.start.is_clear[t, robot]:
                fallen = bool(steps.was_down[t, robot] or steps.fell[t, robot] > 0)
                ends = float(steps.along[t, robot]), float(steps.lateral[t, robot])
                rows.append((int(condition), *ends, fallen))

    columns = zip(*rows, strict=True) if rows else ((), (), (), ())
    kinds = (np.int64, np.float64, np.float64, bool)
    return end_points.EndPoints(
        *(np.array(column, kind) for column, kind in zip(columns, kinds, strict=True))
    )
