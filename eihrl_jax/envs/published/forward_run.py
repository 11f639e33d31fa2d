"""Running along x+ as fast as it goes: the task of DroQ's published learning curves.

Observation: `base.GoalObs`, of which only the proprioception varies, so that what learns in mazes
learns here too. Action: controls in [-1, 1].
Reward: velocity along x in units per second + 1 - 0.5 * squared controls (Gym's Ant without its
price for contact forces, which is a thousandth of the rest).
End of an episode: terminated by a torso outside of the robot's healthy heights or a simulation that
breaks down; truncated after 1,000 control steps.
Reset: the robot, whose root is a free joint, stands at the origin and faces x+, its joints a little
off.

Source: Hiraoka et al. 2021, Sec. 4, and its released code.
"""

from typing import TypeAlias

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.envs import body as body_lib
from eihrl_jax.envs import wrappers
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import scene

EPISODE_STEPS = 1_000  # control steps


class ForwardRunState(struct.PyTreeNode):
    """The state of an episode.

    Attributes:
      physics: the robot.
      total_reward: float32, rewards of the episode so far.
      step: int32, control steps so far.
    """

    physics: engine_lib.PhysicsState
    total_reward: Float[Array, ""]
    step: Int[Array, ""]


EnvState: TypeAlias = base.EnvState[ForwardRunState, base.GoalObs]


class ForwardRun:
    """Open floor, see the module. Metrics, so far in the episode: `return` and control `steps`."""

    def __init__(self, engine: engine_lib.Engine):
        """Takes what moves the robot."""
        self.robot = engine.robot
        self._engine = engine
        self._no_walls = jnp.tile(jnp.array(scene.PARKED_XY), (engine.robot.num_walls, 1))

    def reset(self, key: Key[Array, ""]) -> EnvState:
        """Draws a new episode; the key is consumed."""
        next_key, pose_key = jax.random.split(key)
        physics = body_lib.draw_pose(self._engine, jnp.zeros(2), pose_key)
        physics = body_lib.facing_east(physics)
        inner = ForwardRunState(physics, jnp.float32(0.0), jnp.int32(0))
        return _state(inner, base.Outcome.of_reset(), next_key)

    def step(self, state: EnvState, action: Float[Array, " nu"]) -> EnvState:
        """Advances one control step; after the end nothing moves, and the reward is 0."""
        inner = state.inner
        physics, is_broken = body_lib.advance(
            self._engine, inner.physics, action, self._no_walls, ~state.is_over
        )

        speed = (physics.qpos[0] - inner.physics.qpos[0]) / self.robot.control_step
        reward = speed + 1.0 - 0.5 * jnp.square(action).sum()
        low, high = self.robot.healthy_z or (-jnp.inf, jnp.inf)
        # Unlike in our mazes a robot upside down is well, as long as its torso is high enough.
        has_fallen = (physics.qpos[2] < low) | (physics.qpos[2] > high)
        step = inner.step + 1
        outcome = base.Outcome.of_step(reward, has_fallen | is_broken, step >= EPISODE_STEPS)

        inner = ForwardRunState(physics, inner.total_reward + reward, step)
        return wrappers.rest_if_over(state, _state(inner, outcome, state.key))


def _state(inner: ForwardRunState, outcome: base.Outcome, key: Key[Array, ""]) -> EnvState:
    """Puts together what `reset` and `step` return."""
    # Where the robot is, and how late it is, is told neither here nor in Gym.
    obs = base.GoalObs(
        xy=jnp.zeros(2),
        proprioception=inner.physics.proprioception,
        goal_xy=jnp.zeros(2),
        time=jnp.float32(0.0),
    )
    metrics = {"return": inner.total_reward, "steps": inner.step}
    return base.EnvState.of(inner=inner, obs=obs, outcome=outcome, metrics=metrics, key=key)
