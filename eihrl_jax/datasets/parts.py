"""Files of finished episodes, one per batch, from which an interrupted dataset is resumed."""

import pathlib
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from eihrl_jax import base
from eihrl_jax.datasets import episodes
from eihrl_jax.storage import archives

Arrays = dict[str, np.ndarray]
"""The arrays of an episode by name, such as "infos/qpos" for an array in a dict."""

_LENGTHS, _SEED = "lengths", "seed"
_MAX_SIZE = 2**32  # bytes of a part

_MOMENTS = ("observations", "infos")
"""Arrays with one more entry than there are steps, because the start has one too."""


class Rows:
    """Runs batches of N episodes, compiled once."""

    def __init__(self, recorder: episodes.Recorder, num: int):
        """Compiles nothing yet."""
        self._num = num
        self._reset = jax.jit(jax.vmap(recorder.reset), compiler_options=base.QUICK_COMPILE)
        self._decide = jax.jit(jax.vmap(recorder.decide))

    def run(self, first_seed: int) -> list[Arrays]:
        """Returns N whole episodes, of this seed and the following ones."""
        seeds = np.arange(first_seed, first_seed + self._num, dtype=np.uint32)
        state, shown = self._reset(jax.vmap(jax.random.key)(seeds))
        shown = jax.device_get(shown)

        recorded = []
        while not np.asarray(state.is_over).all():
            state, steps = self._decide(state)
            recorded.append(jax.device_get(steps))
        steps = jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=1), *recorded)
        rows = [jax.tree.map(lambda leaf, i=i: leaf[i], (shown, steps)) for i in range(self._num)]
        return [_episode(*row) for row in rows]


def _episode(first: episodes.Shown, steps: episodes.Steps) -> Arrays:
    """Returns the arrays of one episode, up to its end."""
    num = int(steps.is_running.sum())  # running steps come first
    steps = jax.tree.map(lambda leaf: leaf[:num], steps)
    obs, infos = jax.tree.map(
        lambda start, rest: np.concatenate([start[None], rest]), tuple(first), tuple(steps.shown)
    )
    # No subgoal follows the last state: the one before it is repeated.
    infos["direction"] = np.concatenate([steps.direction, steps.direction[-1:]])
    return _flat(
        {
            "observations": obs,
            "actions": steps.action,
            "rewards": steps.outcome.reward,
            "terminations": steps.outcome.terminated,
            "truncations": steps.outcome.truncated,
            "infos": infos,
        }
    )


def write(path: pathlib.Path, rows: list[Arrays], first_seed: int) -> None:
    """Writes episodes to a file, atomically; `first_seed` is the first one's."""
    arrays = {name: np.concatenate([each[name] for each in rows]) for name in rows[0]}
    arrays[_LENGTHS] = np.array([len(each["rewards"]) for each in rows])
    arrays[_SEED] = np.array(first_seed)
    archives.write(path, arrays)


def read(path: pathlib.Path, first_seed: int) -> Iterator[Arrays]:
    """Returns the episodes of a file that `write` wrote.

    Raises:
      base.UserError: it is damaged, or of another seed.
    """
    try:
        arrays = archives.read(path, limit=_MAX_SIZE)
        lengths, seed = arrays.pop(_LENGTHS), arrays.pop(_SEED)
    except (base.UserError, KeyError) as error:
        raise base.UserError(f"{path} is damaged; remove it, and --resume runs it again") from error
    if seed != first_seed:
        raise base.UserError(
            f"{path} has the episodes of seed {seed}, not {first_seed}; remove it, and --resume "
            "runs them"
        )

    ends = {name: np.cumsum(lengths + (name.partition("/")[0] in _MOMENTS)) for name in arrays}
    for i in range(len(lengths)):
        yield {
            name: array[(ends[name][i - 1] if i else 0) : ends[name][i]]
            for name, array in arrays.items()
        }


def nested(arrays: Arrays) -> dict[str, Any]:
    """Turns names such as "infos/qpos" into nested dicts."""
    made: dict[str, Any] = {}
    for name, array in arrays.items():
        *outer, last = name.split("/")
        inside = made
        for word in outer:
            inside = inside.setdefault(word, {})
        inside[last] = array
    return made


def _flat(values: Any, name: str = "") -> Arrays:
    """Inverse of `nested`."""
    if not isinstance(values, dict):
        return {name: np.asarray(values)}
    parts = [_flat(value, f"{name}/{key}" if name else key) for key, value in values.items()]
    return {key: value for part in parts for key, value in part.items()}
