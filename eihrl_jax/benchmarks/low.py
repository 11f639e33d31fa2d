"""Benchmark of the low level: learner, and physics with a policy in the loop, as ratios."""

import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from eihrl_jax import base
from eihrl_jax.agents import droq, replay
from eihrl_jax.benchmarks import part, timing
from eihrl_jax.config import low as low_config
from eihrl_jax.config import presets
from eihrl_jax.envs import locomotion, wrappers
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import engines, scene
from eihrl_jax.training import low_trainer

NUM_FEATURES, NUM_ACTIONS, CAPACITY, BATCH = 35, 8, 100_000, 256
"""An ant of preset `paper` with a replay that doesn't fit into caches."""

_SIZE = 2048  # large enough for the product to be bound by arithmetic, not by memory
"""Rows and columns of the matrices whose product shows what the machine can do."""

_PER_CALL = 20
"""Critic updates of one call, after which comes one of the actor."""


def updates_per_second(num_updates: int = 400, repeats: int = 5) -> part.Figures:
    """Compares DroQ's updates with those of sbx at equal settings, and with the machine's limit.

    Settings: batch 256, two critics and an actor of 2x256, dropout 0.01, 20 critic updates per
    update of the actor, batches drawn from a replay of 100,000 transitions. Times are taken in
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
    sbx_run = train_sbx(num_updates)  # First, as it may not be installed.
    times = timing.shortest(
        {"ours": train_ours(num_updates), "sbx": sbx_run, "matmul": _matmul()}, repeats
    )

    ours, sbx = num_updates / times["ours"], num_updates / times["sbx"]
    # A product of n x n matrices takes n^3 multiplications and as many additions.
    flops = 2.0 * _SIZE**3 / times["matmul"]
    limit = flops / flops_per_update()
    return {
        "ours": ours,
        "sbx": sbx,
        "limit": limit,
        "gflops": flops / 1e9,
        "ratio": ours / sbx,
        "of_limit": ours / limit,
    }


def updates_rows(figures: part.Figures) -> part.Rows:
    """Returns the table's rows of DroQ's speed."""
    return {
        "DroQ updates per second, batch 256, actor every 20th": (
            f"{figures['ours']:,.0f}; sbx {figures['sbx']:,.0f}: {figures['ratio']:.2f} times; "
            f"{100 * figures['of_limit']:.0f} % of what {figures['gflops']:,.0f} GFLOP/s allow"
        )
    }


def flops_per_update(actor_period: int = _PER_CALL) -> float:
    """Returns the multiplications and additions in the matrix products of one critic update.

    A forward pass of a network counts once, a backward pass to its parameters and its input twice,
    to its input alone once.
    """
    critic = _flops(NUM_FEATURES + NUM_ACTIONS, 256, 256, 1)
    # The actor puts out mean and standard deviation of every control.
    actor = _flops(NUM_FEATURES, 256, 256, 2 * NUM_ACTIONS)

    # The target needs the actor and both target critics forward; both critics learn.
    critic_update = actor + 2 * critic + 2 * 3 * critic
    # The actor learns through both critics, whose parameters need no gradient.
    actor_update = 3 * actor + 2 * 2 * critic
    return critic_update + actor_update / actor_period


def _flops(*sizes: int) -> float:
    """Returns the operations of a batch's forward pass through layers of these sizes."""
    return 2.0 * BATCH * sum(one * other for one, other in itertools.pairwise(sizes))


def walking_rate(num_steps: int = 100, repeats: int = 5) -> part.Figures:
    """Compares ants that walk with a policy in the loop with the engine's own rate.

    Args:
      num_steps: control steps of 64 ants per measurement.
      repeats: measurements of each.

    Returns:
      `walking` and `engine`, control steps per second, and `ratio`.
    """
    # The rooms and the reward of training, whose cost is part of what is measured.
    config = presets.low_best()
    trainer = low_trainer.LowTrainer(config)
    engine = engines.make(trainer.robot, config.engine)
    env = wrappers.AutoReset(locomotion.Locomotion.of_config(engine, config))

    # Ants with the policy, which needs a key per step and ant.
    params = trainer.init(jax.random.key(0)).learner.actor_params
    envs = jax.vmap(env.reset)(jax.random.split(jax.random.key(1), config.num_envs))
    keys = jax.vmap(lambda key: jax.random.split(key, config.num_envs))(
        jax.random.split(jax.random.key(3), num_steps)
    )

    def walk_one(state: base.EnvState, key: jax.Array) -> base.EnvState:
        return env.step(state, trainer.sample(params, state.obs, key))

    # The same ants, pushed at random, without a wall near them.
    shape = (num_steps, config.num_envs, engine.model.nu)
    ctrls = jax.random.uniform(jax.random.key(2), shape, minval=-1.0, maxval=1.0)
    parked = jnp.tile(jnp.array(scene.PARKED_XY), (engine.robot.num_walls, 1))

    def step_one(state: engine_lib.PhysicsState, ctrl: jax.Array) -> engine_lib.PhysicsState:
        return engine.step(state, ctrl, parked)

    walk = timing.rolled(jax.vmap(walk_one), envs, keys)
    step = timing.rolled(jax.vmap(step_one), envs.inner.physics, ctrls)
    times = timing.shortest({"walking": walk, "engine": step}, repeats)
    count = num_steps * config.num_envs
    rates = {name: count / seconds for name, seconds in times.items()}
    return rates | {"ratio": rates["walking"] / rates["engine"]}


def walking_rows(figures: part.Figures) -> part.Rows:
    """Returns the table's rows of the cost of a policy in the loop."""
    measured = f"{100 * figures['ratio']:.0f} % of {figures['engine']:,.0f} control steps/s"
    return {
        "ants that walk with the policy in the loop against the engine alone, 64 ants": measured
    }


def train_ours(num_updates: int) -> Callable[[], droq.DroqState]:
    """Fills our replay with noise and returns our training."""
    learner = droq.Droq(NUM_FEATURES, NUM_ACTIONS, low_config.Droq())
    rows = _transitions(np.random.default_rng(0))
    one = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), rows)
    # Full, as late in a run: batches then come from all over it, and not from caches.
    buffer = replay.add(replay.init(one, CAPACITY), rows)

    @jax.jit
    def train(state: droq.DroqState, buffer: replay.Replay, key: jax.Array) -> droq.DroqState:
        def once(state: droq.DroqState, key: jax.Array) -> tuple[droq.DroqState, None]:
            draw_key, update_key = jax.random.split(key)
            batches = replay.sample(buffer, (_PER_CALL, BATCH), draw_key)
            keys = jax.random.split(update_key, _PER_CALL)
            return jax.lax.scan(lambda s, x: learner.update(s, *x), state, (batches, keys))[0], None

        return jax.lax.scan(once, state, jax.random.split(key, num_updates // _PER_CALL))[0]

    state = jax.jit(learner.init)(jax.random.key(0))
    return lambda: train(state, buffer, jax.random.key(1))


def _transitions(rng: np.random.Generator) -> base.Transition:
    """Draws random transitions, as many as a replay holds."""

    def normal(*shape: int) -> jax.Array:
        return jnp.asarray(rng.normal(size=(CAPACITY, *shape)), jnp.float32)

    return base.Transition(
        obs=normal(NUM_FEATURES),
        action=jnp.tanh(normal(NUM_ACTIONS)),
        reward=normal(),
        discount=jnp.full(CAPACITY, 0.99),
        next_obs=normal(NUM_FEATURES),
    )


def train_sbx(num_updates: int) -> Callable[[], None]:
    """Fills sbx's replay with noise and returns its training, 20 updates a call as it does it."""
    try:
        import gymnasium  # pyright: ignore[reportMissingImports]
        import sbx  # pyright: ignore[reportMissingImports]
        from stable_baselines3.common import logger  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise base.UserError(
            "part updates compares with sbx, which isn't installed: pip install sbx-rl"
        ) from None

    # Never stepped: sbx asks an environment for its spaces.
    class Noise(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (NUM_FEATURES,), np.float32)
        action_space = gymnasium.spaces.Box(-1.0, 1.0, (NUM_ACTIONS,), np.float32)

    # DroQ is SAC with dropout and layer norm in its critics; sbx has it under these options.
    model = sbx.SAC(
        "MlpPolicy",
        Noise(),
        buffer_size=CAPACITY,
        batch_size=BATCH,
        gradient_steps=_PER_CALL,
        policy_delay=_PER_CALL,
        policy_kwargs={"dropout_rate": 0.01, "layer_norm": True},
    )
    model.set_logger(logger.configure(format_strings=[]))

    rng, buffer = np.random.default_rng(0), model.replay_buffer
    assert buffer is not None
    buffer.observations[:] = rng.normal(size=buffer.observations.shape)
    buffer.next_observations[:] = rng.normal(size=buffer.next_observations.shape)
    buffer.actions[:] = np.tanh(rng.normal(size=buffer.actions.shape))
    buffer.rewards[:] = rng.normal(size=buffer.rewards.shape)
    buffer.full = True  # or it would draw from the rows up to its position alone, which is 0

    def train() -> None:
        for _ in range(num_updates // _PER_CALL):
            model.train(_PER_CALL, BATCH)
        # sbx returns before its last update is done.
        jax.block_until_ready(model.policy.qf_state.params)

    return train


def _matmul() -> Callable[[], jax.Array]:
    """Returns a large matrix product, the fastest that a machine can multiply."""
    factor = jnp.asarray(np.random.default_rng(0).normal(size=(_SIZE, _SIZE)), jnp.float32)
    product = jax.jit(jnp.matmul)
    return lambda: product(factor, factor)
