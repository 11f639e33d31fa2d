"""The mazes and the low level's task as environments of Brax, for learners that are written for it.

    from brax.training.agents.ppo import train as ppo
    import eihrl_jax.brax

    env = eihrl_jax.brax.MazeEnv("u", "point", reward="dense")
    with eihrl_jax.brax.replicating():  # Brax 0.14.2 with a JAX that is newer than it
        ppo.train(env, 1_000_000, wrap_env_fn=eihrl_jax.brax.wrap, episode_length=env.episode_steps)

`pip install eihrl_jax[brax]` brings Brax; `docs/brax.md` tells more.
"""

import contextlib
import io

try:
    # Asked for before anything else is imported. Brax imports MJX, which without Warp, of no use
    # here, prints that it is missing.
    with contextlib.redirect_stdout(io.StringIO()):
        from brax import envs as _envs  # noqa: F401
except ImportError as error:
    raise ImportError("eihrl_jax.brax needs Brax: pip install 'eihrl_jax[brax]'") from error

from eihrl_jax.brax.devices import replicating
from eihrl_jax.brax.envs import LocomotionEnv, MazeEnv
from eihrl_jax.brax.wrapping import wrap

__all__ = ["LocomotionEnv", "MazeEnv", "replicating", "wrap"]
