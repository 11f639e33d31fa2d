"""Measures how many robots that lie on the ground stand again."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from eihrl_jax import base
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import body as body_lib
from eihrl_jax.envs import hierarchy, locomotion, rooms
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.runs import progress as progress_lib

AFTER = (1, 4)
"""Numbers of subgoals after which those that stand are counted."""


@dataclasses.dataclass(frozen=True)
class Standing:
    """How many robots stood again.

    Attributes:
      num_thrown: robots that were thrown, in any posture.
      num_down: how many of them lay on the ground a subgoal's time later, their controls at rest.
      shares: of those, by number of subgoals given since, how many stand.
    """

    num_thrown: int
    num_down: int
    shares: dict[int, float]


def measure(
    engine: engine_lib.Engine, policy: hierarchy.LowPolicy, num: int, key: Key[Array, ""]
) -> Standing | None:
    """Throws `num` robots on open floor, and lets those that lie there follow subgoals.

    Args:
      engine: drives the robot.
      policy: its low level.
      num: how many are thrown.
      key: of postures and subgoals.

    Returns:
      How many stood again; None for a robot that can't fall.
    """
    robot = engine.robot
    if robot.healthy_z is None:
        return None
    k = robot.steps_per_subgoal
    env = locomotion.Locomotion(
        engine,
        rooms.open_floor(),
        reward_options=low_config.LowReward(),  # unused: nothing is learned here
        episode_steps=(AFTER[-1] + 2) * k,
        ends_at_fall=False,
        thrown_share=1.0,
    )
    reset_key, act_key = jax.random.split(key)
    num_controls = engine.model.nu

    def rest(state: locomotion.EnvState, _: None) -> tuple[locomotion.EnvState, None]:
        return jax.vmap(env.step)(state, jnp.zeros((num, num_controls))), None

    def follow(state: locomotion.EnvState, _: None) -> tuple[locomotion.EnvState, None]:
        ctrls = jax.vmap(lambda obs: policy(obs, act_key))(state.obs)
        return jax.vmap(env.step)(state, ctrls), None

    @jax.jit
    def is_down(state: locomotion.EnvState) -> Bool[Array, " N"]:
        qpos: Float[Array, "N nq"] = state.inner.physics.qpos
        return jax.vmap(lambda q: body_lib.is_fallen(q, robot))(qpos)

    # A subgoal's time is enough to come to rest, whatever the robot.
    reset = jax.jit(jax.vmap(env.reset), compiler_options=base.QUICK_COMPILE)
    state = reset(jax.random.split(reset_key, num))
    lie = jax.jit(lambda state: jax.lax.scan(rest, state, length=k)[0])
    walk = jax.jit(lambda state: jax.lax.scan(follow, state, length=k)[0])
    shares: dict[int, float] = {}
    with progress_lib.Progress(f"{robot.name}, standing up", AFTER[-1] + 1) as bar:
        state = lie(state)
        was_down = np.asarray(is_down(state))
        bar.update(1)

        for number in range(1, AFTER[-1] + 1):
            state = walk(state)
            if number in AFTER:
                stands = ~np.asarray(is_down(state))[was_down]
                shares[number] = float(stands.mean()) if len(stands) else float("nan")
            bar.update(number + 1)
    return Standing(num, int(was_down.sum()), shares)
