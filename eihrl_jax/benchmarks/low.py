"""Measurements of the low level for `experiments.benchmark`: learner and walking, as ratios."""

import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from eihrl_jax import base
from eihrl_jax.agents import droq, replay
from eihrl_jax.benchmarks import timing
from eihrl_jax.config import low as low_config
from eihrl_jax.config import presets
from eihrl_jax.envs import locomotion, rooms, wrappers
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import engines, scene
from eihrl_jax.training import low

NUM_FEATURES, NUM_ACTIONS, CAPACITY, BATCH = 35, 8, 100_000, 256
"""An ant of preset `paper` with a memory that doesn't fit into caches."""


_SIZE = 2048


def updates_per_second(num_updates: int = 400, repeats: int = 5) -> dict[str, Any]:
    """Compares DroQ's updates with those of sbx at equal settings, and with the machine's limit.

    Settings: batch 256, two critics and an actor of 2x256, dropout 0.01, 20 critic updates per
    update of the actor, batches drawn from a memory of 100,000 transitions. Times are taken in
    turns; the shortest of each counts.

    Args:
      num_updates: critic updates per measurement, a multiple of 20.
      repeats: measurements of each.

    Returns:
      Updates per second: `ours`, `sbx`, and `limit`, at which the same multiplications would run at
      the rate of large float32 matrix products; `ratio`, ours/sbx, and `of_limit`, ours/limit.

    Raises:
      base.UserError: sbx isn't installed.
    """
    theirs = _sbx(num_updates)
    times = timing.shortest(
        {"ours": _ours(num_updates), "sbx": theirs, "matmul": _matmul()}, repeats
    )
    rate = 2.0 * _SIZE**3 / times["matmul"]
    found = {name: num_updates / times[name] for name in ("ours", "sbx")}
    limit = rate / flops_per_update()
    return found | {
        "limit": limit,
        "gflops": rate / 1e9,
        "ratio": found["ours"] / found["sbx"],
        "of_limit": found["ours"] / limit,
    }


def flops_per_update(actor_period: int = 20) -> float:
    """Returns the multiplications and additions in the matrix products of one critic update.

    A forward pass of a network counts once, a backward pass to its parameters and its input twice,
    to its input alone once.
    """
    critic = _flops(NUM_FEATURES + NUM_ACTIONS, 256, 256, 1)
    actor = _flops(NUM_FEATURES, 256, 256, 2 * NUM_ACTIONS)
    critic_update = actor + 2 * critic + 2 * 3 * critic
    actor_update = 3 * actor + 2 * 2 * critic
    return critic_update + actor_update / actor_period


def _flops(*sizes: int) -> float:
    return 2.0 * BATCH * sum(one * other for one, other in itertools.pairwise(sizes))


def walking_rate(num_steps: int = 100, repeats: int = 5) -> dict[str, float]:
    """Compares ants that walk with a policy in the loop with the engine's own rate.

    Args:
      num_steps: control steps of 64 ants per measurement.
      repeats: measurements of each.

    Returns:
      `walking` and `engine`, control steps per second, and `ratio`.
    """
    config = presets.low_best()
    trainer = low.LowTrainer(config)
    engine = engines.make(trainer.robot, config.engine)
    env = wrappers.AutoReset(
        locomotion.Locomotion(
            engine, rooms.random_rooms(config.num_rooms, 0), reward_options=config.reward
        )
    )
    params = trainer.init(jax.random.key(0)).learner.actor_params
    envs = jax.vmap(env.reset)(jax.random.split(jax.random.key(1), config.num_envs))
    shape = (num_steps, config.num_envs, engine.model.nu)
    ctrls = jax.random.uniform(jax.random.key(2), shape, minval=-1.0, maxval=1.0)
    parked = jnp.tile(jnp.array(scene.PARKED_XY), (engine.robot.num_walls, 1))

    def walk_one(state: base.EnvState, key: jax.Array) -> base.EnvState:
        return env.step(state, trainer.sample(params, state.obs, key))

    def step_one(state: engine_lib.PhysicsState, ctrl: jax.Array) -> engine_lib.PhysicsState:
        return engine.step(state, ctrl, parked)

    keys = jax.vmap(lambda key: jax.random.split(key, config.num_envs))(
        jax.random.split(jax.random.key(3), num_steps)
    )
    walk = _scan(walk_one, envs, keys)
    step = _scan(step_one, envs.inner.physics, ctrls)
    times = timing.shortest({"walking": walk, "engine": step}, repeats)
    count = num_steps * config.num_envs
    rates = {name: count / seconds for name, seconds in times.items()}
    return rates | {"ratio": rates["walking"] / rates["engine"]}


def _scan(step: Callable[[Any, Any], Any], state: Any, inputs: Any) -> Callable[[], Any]:
    """Returns a function that steps a batch through inputs with leading axes time and batch."""
    roll = jax.jit(
        lambda state: jax.lax.scan(lambda s, x: (jax.vmap(step)(s, x), None), state, inputs)[0]
    )
    return lambda: roll(state)


def _ours(num_updates: int) -> Callable[[], Any]:
    learner = droq.Droq(NUM_FEATURES, NUM_ACTIONS, low_config.Droq())
    rows = _transitions(np.random.default_rng(0))
    one = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), rows)
    memory = replay.add(replay.init(one, CAPACITY), rows)

    @jax.jit
    def train(state: droq.DroqState, memory: replay.Replay, key: jax.Array) -> droq.DroqState:
        def once(state: droq.DroqState, key: jax.Array) -> tuple[droq.DroqState, None]:
            draw_key, update_key = jax.random.split(key)
            batches = replay.sample(memory, (20, BATCH), draw_key)
            keys = jax.random.split(update_key, 20)
            return jax.lax.scan(lambda s, x: learner.update(s, *x), state, (batches, keys))[0], None

        return jax.lax.scan(once, state, jax.random.split(key, num_updates // 20))[0]

    state = jax.jit(learner.init)(jax.random.key(0))
    return lambda: train(state, memory, jax.random.key(1))


def _transitions(rng: np.random.Generator) -> base.Transition:
    def normal(*shape: int) -> jax.Array:
        return jnp.asarray(rng.normal(size=(CAPACITY, *shape)), jnp.float32)

    return base.Transition(
        obs=normal(NUM_FEATURES),
        action=jnp.tanh(normal(NUM_ACTIONS)),
        reward=normal(),
        discount=jnp.full(CAPACITY, 0.99),
        next_obs=normal(NUM_FEATURES),
    )


def _sbx(num_updates: int) -> Callable[[], Any]:
    """Fills sbx's memory with noise and returns its training, 20 updates a call as it does it."""
    try:
        import gymnasium  # pyright: ignore[reportMissingImports]
        import sbx  # pyright: ignore[reportMissingImports]
        from stable_baselines3.common import logger  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise base.UserError(
            "part updates compares with sbx, which isn't installed: pip install sbx-rl"
        ) from None

    class Noise(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (NUM_FEATURES,), np.float32)
        action_space = gymnasium.spaces.Box(-1.0, 1.0, (NUM_ACTIONS,), np.float32)

    model = sbx.SAC(
        "MlpPolicy",
        Noise(),
        buffer_size=CAPACITY,
        batch_size=BATCH,
        gradient_steps=20,
        policy_delay=20,
        policy_kwargs={"dropout_rate": 0.01, "layer_norm": True},
    )
    model.set_logger(logger.configure(format_strings=[]))
    rng, memory = np.random.default_rng(0), model.replay_buffer
    assert memory is not None
    memory.observations[:] = rng.normal(size=memory.observations.shape)
    memory.next_observations[:] = rng.normal(size=memory.next_observations.shape)
    memory.actions[:] = np.tanh(rng.normal(size=memory.actions.shape))
    memory.rewards[:] = rng.normal(size=memory.rewards.shape)
    memory.full = True

    def train() -> None:
        for _ in range(num_updates // 20):
            model.train(20, BATCH)
        jax.block_until_ready(model.policy.qf_state.params)

    return train


def _matmul() -> Callable[[], Any]:
    factor = jnp.asarray(np.random.default_rng(0).normal(size=(_SIZE, _SIZE)), jnp.float32)
    product = jax.jit(jnp.matmul)
    return lambda: product(factor, factor)
