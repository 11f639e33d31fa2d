"""When robots that follow subgoals fall, and how soon they stand again."""

import math

import numpy as np
from jaxtyping import Float

from eihrl_jax import base
from eihrl_jax.evaluation import steps as steps_lib

TURNS = ("straight", "quarter", "half")
"""What a subgoal asks of a robot that has followed another one: no turn, to a side, or back."""


def by_turn(steps: steps_lib.Steps) -> dict[str, float]:
    """Returns falls per 1,000 subgoals by the turn that each asked for, in the order of `TURNS`.

    Counted are subgoals that began upright, less the first one of every episode, which follows
    none; NaN where there were none.

    Args:
      steps: on the host.
    """
    direction, ended = np.asarray(steps.direction), np.asarray(steps.ended)
    is_upright = np.asarray(steps.start.is_upright)
    is_last = (np.asarray(steps.switched) > 0) | ended
    follows = np.zeros_like(ended)
    follows[1:] = is_last[:-1] & ~ended[:-1]

    # The turn at its first step is each subgoal's own until another one begins.
    toward = np.array(base.DIRECTIONS_XY)[direction]
    cosine = np.zeros(direction.shape)
    cosine[1:] = (toward[1:] * toward[:-1]).sum(-1)
    begins = np.r_[np.ones((1, ended.shape[1]), bool), is_last[:-1]]
    step = np.arange(len(ended))[:, None]
    first = np.maximum.accumulate(np.where(begins, step, 0))
    turn = np.take_along_axis(np.where(follows, 1 - cosine, np.nan), first, 0)

    rates = {}
    for number, name in enumerate(TURNS):
        is_counted = (turn == number) & is_upright
        num = int((is_counted & begins).sum())
        num_falls = int((is_counted & (np.asarray(steps.fell) > 0)).sum())
        rates[name] = 1000.0 * num_falls / num if num else math.nan
    return rates


def recovery_times(steps: steps_lib.Steps, min_steps: int) -> Float[np.ndarray, " F"]:
    """Returns, for each fall, the control steps until the robot stood again, inf for never.

    Args:
      steps: on the host.
      min_steps: a fall without recovery is left out where its episode ended within fewer steps.
    """
    times = []
    for t, robot in np.argwhere(steps.fell > 0):
        # Within the same episode: every new one starts upright.
        ended = np.flatnonzero(steps.ended[t:, robot])
        end = t + ended[0] if len(ended) else len(steps.ended) - 1

        upright = np.flatnonzero(~steps.was_down[t + 1 : end + 1, robot])
        if len(upright):
            times.append(float(upright[0] + 1))
        elif end - t >= min_steps:
            times.append(math.inf)
    return np.array(times)
