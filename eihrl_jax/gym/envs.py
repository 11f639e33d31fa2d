"""What the Gymnasium environments have in common: one robot, and many in parallel."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import jax
import numpy as np
from gymnasium import vector

from eihrl_jax import base
from eihrl_jax.config import checks
from eihrl_jax.drawing import snapshot
from eihrl_jax.gym import episodes, places
from eihrl_jax.gym.episodes import Info, Mode, Shown

_MAX_ENVS = 2**20
_RENDER_MODE = "rgb_array"


class SingleEnv(gymnasium.Env[Any, Any]):
    """One robot.

    A seed determines the first episode and all that follow until another seed is given. They are
    those of the bare environment with `jax.random.key(seed)`.

    Attributes:
      task: the environment to run, and how to show it.
    """

    metadata: dict[str, Any] = {"render_modes": [_RENDER_MODE]}  # noqa: RUF012 (as Gymnasium has it)

    def __init__(self, task: episodes.Task, render_mode: str | None):
        """Compiles nothing yet.

        Raises:
          base.UserError: the render mode is unknown.
        """
        self.task = task
        self.render_mode = _checked(render_mode)
        self.metadata = {**self.metadata, "render_fps": task.fps}
        self.observation_space, self.action_space = task.spaces()
        self._rows = episodes.Rows(task, 1)
        self._painter = snapshot.Painter(task.robot)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Shown, Info]:
        """Begins a new episode.

        Args:
          seed: of all following draws; None: the random stream goes on.
          options: `start_cell` and `goal_cell`, see `places.choose`.

        Raises:
          base.UserError: an option is unknown or has a wrong value.
        """
        options = places.check_options(options, (places.START, places.GOAL))
        super().reset(seed=seed)
        seeds = None if seed is None else [seed]
        obs, info = self._rows.reset(seeds, options, self.np_random)
        return _first(obs), _first(info)

    def step(self, action: Any) -> tuple[Shown, float, bool, bool, Info]:
        """Advances one step.

        Raises:
          base.UserError: no episode has begun, or the action doesn't fit.
        """
        step = self._rows.step([action])
        reward, terminated, truncated = _first((step.reward, step.terminated, step.truncated))
        return _first(step.obs), reward, terminated, truncated, _first(step.info)

    def render(self) -> Any:
        """Returns a picture, uint8 [H, W, 3]; None without render mode.

        Raises:
          base.UserError: no episode has begun.
        """
        if self.render_mode is None:
            return None
        return self._rows.draw(self._painter)[0]

    def close(self) -> None:
        """Closes the renderer."""
        self._painter.close()


class ParallelEnv(vector.VectorEnv[Any, Any, np.ndarray]):
    """Robots in parallel, one compiled step for all.

    Row i is seeded with seed + i, as in Gymnasium's own vector environments, and runs the episodes
    of a `SingleEnv` with that seed. What follows the end of an episode is the mode's:

    - SAME_STEP: the next one begins in the same step; what was last seen of the old one and its
      metrics are in the info, `final_obs` and `final_info`;
    - NEXT_STEP: the next one begins in the next step, whose action has no effect;
    - DISABLED: the row rests until `reset(options={"reset_mask": …})`, bool [N].
    """

    metadata: dict[str, Any] = {"render_modes": [_RENDER_MODE]}  # noqa: RUF012

    def __init__(
        self,
        task: episodes.Task,
        num_envs: int,
        autoreset_mode: str | Mode,
        render_mode: str | None,
    ):
        """Compiles nothing yet.

        Raises:
          base.UserError: `num_envs` is out of its limits, or a mode is unknown.
        """
        modes = {mode.value: mode for mode in Mode}
        value = autoreset_mode.value if isinstance(autoreset_mode, Mode) else autoreset_mode
        checks.one_of("autoreset_mode", value, modes)
        self.num_envs = places.whole("num_envs", num_envs, _MAX_ENVS)
        self.render_mode = _checked(render_mode)

        self.single_observation_space, self.single_action_space = task.spaces()
        self.observation_space = vector.utils.batch_space(
            self.single_observation_space, self.num_envs
        )
        self.action_space = vector.utils.batch_space(self.single_action_space, self.num_envs)
        self.metadata = {
            **self.metadata,
            "render_fps": task.fps,
            "autoreset_mode": modes[value],
        }
        self._rows = episodes.Rows(task, self.num_envs, modes[value])
        self._painter = snapshot.Painter(task.robot)

    def reset(
        self,
        *,
        seed: int | Sequence[int] | None = None,
        options: Any = None,
    ) -> tuple[Shown, Info]:
        """Begins new episodes, in all rows unless `reset_mask` names some.

        Args:
          seed: of row 0 (row i has seed + i), or one per row; None: the random streams go on.
          options: `start_cell` and `goal_cell`, for all rows or one each, see `places.choose`;
            `reset_mask`.

        Raises:
          base.UserError: an option is unknown or has a wrong value; the seeds are more or fewer
            than the rows.
        """
        options = places.check_options(options, (places.START, places.GOAL, places.MASK))
        seeds = self._seeds(seed)
        super().reset(seed=None if seeds is None else seeds[0])
        return self._rows.reset(seeds, options, self.np_random)

    def step(self, actions: np.ndarray) -> tuple[Shown, np.ndarray, np.ndarray, np.ndarray, Info]:
        """Advances every robot one step.

        Raises:
          base.UserError: no episode has begun, or the actions don't fit.
        """
        step = self._rows.step(actions)
        info, is_over = step.info, step.terminated | step.truncated
        if self._rows.mode == Mode.SAME_STEP and is_over.any():
            # Gymnasium's names; those with an underscore say which rows are meant.
            info = {
                **info,
                "final_obs": step.final,
                "_final_obs": is_over,
                "final_info": {name: value.copy() for name, value in info.items()},
                "_final_info": is_over.copy(),
            }
        return step.obs, step.reward, step.terminated, step.truncated, info

    def render(self) -> tuple[Any, ...] | None:
        """Returns a picture of every row, uint8 [H, W, 3]; None without render mode.

        Raises:
          base.UserError: no episode has begun.
        """
        if self.render_mode is None:
            return None
        return tuple(self._rows.draw(self._painter))

    def close_extras(self, **kwargs: Any) -> None:
        """Closes the renderer."""
        del kwargs
        self._painter.close()

    def _seeds(self, seed: int | Sequence[int] | None) -> list[int] | None:
        """Returns the seed of each row."""
        if seed is None:
            return None
        if isinstance(seed, int | np.integer):
            return [int(seed) + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise base.UserError(f"seed: {len(seed)} of them for {self.num_envs} rows")
        return [int(each) for each in seed]


def _checked(render_mode: str | None) -> str | None:
    """Returns the render mode, which must be a known one or None."""
    if render_mode is not None:
        checks.one_of("render_mode", render_mode, [_RENDER_MODE])
    return render_mode


def _first(values: Any) -> Any:
    """Returns the first row of arrays, single numbers as Python's."""
    return jax.tree.map(lambda x: x[0] if x.ndim > 1 else x[0].item(), values)
