"""Running along x+ as fast as it goes: the task of DroQ's published learning curves.

Observation: `base.GoalObs` of which only the proprioception tells anything, so that what learns in
mazes learns here too. Action: controls in [-1, 1].
Reward: velocity along x in units per second + 1 - 0.5 * squared controls (Gym's Ant without its
price for contact forces, which is a thousandth of the rest).
End of an episode: terminated by a torso outside of the robot's healthy heights or a simulation that
breaks down; truncated after 1,000 control steps.
Reset: the robot, whose root is a free joint, stands at the origin and faces x+, its joints a little
off.

Source: Hiraoka et al. 2021, Sec. 4, and its released code.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.envs import body as body_lib
from eihrl_jax.ops import tree
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import scene

EPISODE_STEPS = 1_000


class ForwardRunState(struct.PyTreeNode):
    """The state of an episode: the robot, rewards so far, and control steps so far."""

    physics: engine_lib.PhysicsState
    total_reward: Float[Array, ""]
    step: Int[Array, ""]


class ForwardRun:
    """Open floor. Metrics, so far in the episode: `return` and control `steps`."""

    def __init__(self, engine: engine_lib.Engine):
        """Takes what moves the robot."""
        self.robot = engine.robot
        self._engine = engine
        self._no_walls = jnp.tile(jnp.array(scene.PARKED_XY), (engine.robot.num_walls, 1))

    def reset(self, key: Key[Array, ""]) -> base.EnvState:
        """Draws a new episode; the key is consumed."""
        next_key, pose_key = jax.random.split(key)
        physics = body_lib.draw_pose(self._engine, jnp.zeros(2), pose_key)
        qpos = physics.qpos.at[3:7].set(jnp.array([1.0, 0.0, 0.0, 0.0]))
        physics = engine_lib.reset(qpos, physics.qvel)
        zero, no = jnp.float32(0.0), jnp.zeros((), bool)
        return _state(ForwardRunState(physics, zero, jnp.int32(0)), zero, no, no, next_key)

    def step(self, state: base.EnvState, action: Float[Array, " nu"]) -> base.EnvState:
        """Advances one control step; an episode that is over rests, and pays nothing."""
        inner: ForwardRunState = state.inner
        is_running = ~(state.terminated | state.truncated)
        physics, is_broken = body_lib.advance(
            self._engine, inner.physics, action, self._no_walls, is_running
        )
        speed = (physics.qpos[0] - inner.physics.qpos[0]) / self.robot.control_step
        reward = speed + 1.0 - 0.5 * jnp.square(action).sum()
        low, high = self.robot.healthy_z or (-jnp.inf, jnp.inf)
        has_fallen = (physics.qpos[2] < low) | (physics.qpos[2] > high)
        step = inner.step + 1
        ended = has_fallen | is_broken
        moved = _state(
            ForwardRunState(physics, inner.total_reward + reward, step),
            reward,
            ended,
            (step >= EPISODE_STEPS) & ~ended,
            state.key,
        )
        rested = state.replace(reward=jnp.float32(0.0))
        return tree.where(is_running, moved, rested)


def _state(
    inner: ForwardRunState,
    reward: Float[Array, ""],
    terminated: Array,
    truncated: Array,
    key: Key[Array, ""],
) -> base.EnvState:
    """Puts together what `reset` and `step` return."""
    obs = base.GoalObs(
        xy=jnp.zeros(2),
        proprioception=inner.physics.proprioception,
        goal_xy=jnp.zeros(2),
        time=jnp.float32(0.0),
    )
    return base.EnvState(
        inner=inner,
        obs=obs,
        final_obs=obs,
        reward=reward,
        terminated=terminated,
        truncated=truncated,
        metrics={"return": inner.total_reward, "steps": inner.step.astype(jnp.float32)},
        key=key,
    )
