"""Our robots in parallel as a `VecEnv` of Stable-Baselines3, for its learners and those of sbx.

    from eihrl_jax.gym import MazeVectorEnv, sb3

    envs = sb3.VecEnv(MazeVectorEnv(64, "u", "point", autoreset_mode="SameStep"))
    stable_baselines3.PPO("MlpPolicy", envs).learn(1_000_000)

`pip install eihrl_jax[examples]` brings both libraries.
"""

from typing import Any

import gymnasium
import jax
import numpy as np
from stable_baselines3.common import vec_env  # pyright: ignore[reportMissingImports]

from eihrl_jax import base
from eihrl_jax.gym import envs, episodes


class VecEnv(vec_env.VecEnv):
    """A `ParallelEnv` as Stable-Baselines3 has it; all rows are one environment.

    The info of a row is empty but where an episode ends. There it holds the metrics, `is_success`,
    `terminal_observation` and `TimeLimit.truncated`.
    """

    def __init__(self, parallel: envs.ParallelEnv):
        """Wraps environments with autoreset mode SameStep.

        Raises:
          base.UserError: their mode is another one.
        """
        mode = parallel.metadata["autoreset_mode"]
        if mode != episodes.Mode.SAME_STEP:
            raise base.UserError(f"autoreset_mode = {mode.value!r} must be SameStep for this")

        self._envs = parallel
        self._actions = np.zeros(0)
        super().__init__(
            parallel.num_envs, parallel.single_observation_space, parallel.single_action_space
        )

    def reset(self) -> episodes.Shown:
        """Begins new episodes, with the seeds and options that were set since the last reset."""
        seeds = None if None in self._seeds else self._seeds
        obs, info = self._envs.reset(seed=seeds, options=self._merged_options())
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = [_row(info, i) for i in range(self.num_envs)]
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions of the next step."""
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[episodes.Shown, np.ndarray, np.ndarray, list[episodes.Info]]:
        """Advances every robot one step, and into the next episode where one has ended."""
        obs, reward, terminated, truncated, info = self._envs.step(self._actions)
        is_over = terminated | truncated

        infos: list[episodes.Info] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(is_over):
            infos[i] = {
                **_row(info["final_info"], i),
                "terminal_observation": jax.tree.map(lambda x, i=i: x[i], info["final_obs"]),
                "TimeLimit.truncated": bool(truncated[i]),
            }
        return obs, reward, is_over, infos

    def close(self) -> None:
        """Closes the environment."""
        self._envs.close()

    def get_attr(self, attr_name: str, indices: vec_env.base_vec_env.VecEnvIndices = None) -> list:
        """Returns an attribute of the environment, once for each row."""
        return [getattr(self._envs, attr_name) for _ in self._get_indices(indices)]

    def set_attr(
        self, attr_name: str, value: Any, indices: vec_env.base_vec_env.VecEnvIndices = None
    ) -> None:
        """Sets an attribute of the environment, which is that of all rows."""
        del indices
        setattr(self._envs, attr_name, value)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: vec_env.base_vec_env.VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list:
        """Calls a method of the environment, once for each row."""
        method = getattr(self._envs, method_name)
        return [method(*method_args, **method_kwargs) for _ in self._get_indices(indices)]

    def get_images(self) -> tuple[np.ndarray, ...]:
        """Returns a picture of every row, none without render mode."""
        return self._envs.render() or ()

    def env_is_wrapped(
        self,
        wrapper_class: type[gymnasium.Wrapper],
        indices: vec_env.base_vec_env.VecEnvIndices = None,
    ) -> list[bool]:
        """Returns that no row is wrapped."""
        del wrapper_class
        return [False for _ in self._get_indices(indices)]

    def _merged_options(self) -> dict[str, list]:
        """Returns the rows' options as one dict with an entry for each row."""
        names = {name for options in self._options for name in options}
        if any(set(options) != names for options in self._options):
            raise base.UserError(f"options: {sorted(names)} must be given for every row or none")
        return {name: [options[name] for options in self._options] for name in names}


def _row(info: episodes.Info, i: int | np.integer) -> episodes.Info:
    """Returns the info of one row."""
    return {name: value[i].item() for name, value in info.items()}
