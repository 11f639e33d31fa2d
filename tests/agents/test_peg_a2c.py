"""PEG-A2C on probe environments with known values, and the promises of a learner."""

import dataclasses
import functools

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax.agents import peg_a2c
from eihrl_jax.config import high
from eihrl_jax.envs import wrappers
from eihrl_jax.training import parallel
from tests.agents import probe_envs
from tests.agents.probe_envs import Kind

GAMMA = 0.5
NUM_WORKERS = 64
MESH = functools.partial(parallel.make_mesh, 1, num_workers=NUM_WORKERS)


class Perceptron(nn.Module):
    """A small actor-critic for the probes' few numbers."""

    @nn.compact
    def __call__(self, obs):
        features = nn.tanh(nn.Dense(32)(obs))
        return nn.Dense(4)(features), nn.Dense(1)(features)[0]


def make(window=None, **options):
    """Makes a learner of the probes, by windows or by whole episodes."""
    options = {"num_updates": 400, "learning_rate": 0.02, "entropy": 0.003} | options
    learner = high.Learner(
        num_workers=NUM_WORKERS,
        window=window,
        looks_beyond_limit=True,
        gamma=GAMMA,
        optimiser="adam",
        max_grad_norm=10.0,
        **options,
    )
    probe = probe_envs.Probe()
    env = probe if window is None else wrappers.AutoReset(probe)
    return peg_a2c.PegA2C(env, Perceptron(), learner, window or probe.length)


@dataclasses.dataclass(frozen=True)
class Trained:
    """A learner after training, by its window; `first` and `again` are after a quarter of it."""

    window: int | None
    num_compiled: int
    first: peg_a2c.LearnerState
    again: peg_a2c.LearnerState
    metrics: dict
    judge: object

    def value(self, kind, cue=1.0, step=0):
        """Returns the value of one observation."""
        return self.judge(probe_envs.observe(kind, cue, step))[1]

    def probability(self, kind, action, cue=1.0):
        """Returns the probability of one action."""
        return jax.nn.softmax(self.judge(probe_envs.observe(kind, cue))[0])[action]


@pytest.fixture(scope="module", params=[None, 2], ids=["episodes", "windows"])
def trained(request):
    agent = make(request.param)
    update = parallel.repeated_update(agent, 100, MESH())

    def copied(state):
        return jax.tree.map(lambda leaf: leaf.copy(), state)

    start = parallel.init(agent, 0, MESH())
    again = update(copied(start))[0]
    state = update(start)[0]
    first = copied(state)
    for _ in range(3):
        state, metrics = update(state)
    judge = jax.jit(lambda obs: agent.network.apply(state.params, obs))
    return Trained(request.param, update._cache_size(), first, again, metrics, judge)


def test_value_of_a_constant_reward(trained):
    np.testing.assert_allclose(trained.value(Kind.CONSTANT), 1.0, atol=0.1)


def test_value_depends_on_the_observation(trained):
    for cue in (-1.0, 1.0):
        np.testing.assert_allclose(trained.value(Kind.CUE, cue), cue, atol=0.1)


def test_a_delayed_reward_is_discounted_once(trained):
    np.testing.assert_allclose(trained.value(Kind.DELAY), GAMMA, atol=0.1)
    np.testing.assert_allclose(trained.value(Kind.DELAY, step=1), 1.0, atol=0.1)


def test_policy_finds_the_action_that_pays(trained):
    assert trained.probability(Kind.ACTION, 2) > 0.9
    np.testing.assert_allclose(trained.value(Kind.ACTION), 1.0, atol=0.1)


def test_policy_depends_on_the_observation(trained):
    assert trained.probability(Kind.CUE_AND_ACTION, 0, cue=-1.0) > 0.9
    assert trained.probability(Kind.CUE_AND_ACTION, 1, cue=1.0) > 0.9


def test_nothing_is_expected_beyond_an_end(trained):
    # A window may end between the two steps and then takes the mean of both for the second.
    np.testing.assert_allclose(trained.value(Kind.ENDED), 1.0 + GAMMA / 2, atol=0.15)


def test_windows_look_beyond_a_time_limit_and_whole_episodes_do_not(trained):
    expected = 1.0 + GAMMA / 2 if trained.window is None else 1.0 / (1.0 - GAMMA)
    np.testing.assert_allclose(trained.value(Kind.CUT), expected, atol=0.15)


def test_metrics_add_up_over_the_episodes_that_ended(trained):
    metrics = jax.tree.map(lambda x: np.asarray(x).sum(), trained.metrics)
    # Mean return of the best policy over the seven kinds; the cue's mean is 0.
    expected = (1 + 0 + 1 + 1 + 1 + 2 + 2) / 7
    np.testing.assert_allclose(metrics["sum_return"] / metrics["episodes"], expected, atol=0.1)
    np.testing.assert_allclose(metrics["decisions"] / metrics["episodes"], 10 / 7, atol=0.05)


@pytest.fixture(scope="module")
def collected():
    """Returns a learner by whole episodes, parameters, and a batch with axes [T, W]."""
    agent = dataclasses.replace(make(value_coef=0.25, entropy=0.0, entropy_end=0.0), horizon=3)

    @jax.jit
    def collect():
        state = agent.init(jax.random.key(0))
        collect = jax.vmap(agent.collect, (None, 0, 0), (0, 1, 0))
        return state.params, *collect(state.params, state.env_state, state.keys)[1:]

    return agent, *collect()


def test_decisions_after_the_end_of_an_episode_do_not_count(collected):
    _, _, batch, counts = collected
    kind = batch.encoding[0, :, : len(Kind)].argmax(-1)
    is_long = np.isin(kind, probe_envs.TWO_STEPS)
    np.testing.assert_allclose(batch.weight[0], np.where(is_long, 0.5, 1.0))
    np.testing.assert_allclose(batch.weight[1], np.where(is_long, 0.5, 0.0))
    np.testing.assert_allclose(batch.weight[2], 0.0)
    np.testing.assert_allclose(counts["decisions"], np.where(is_long, 2.0, 1.0))
    np.testing.assert_allclose(counts["episodes"], 1.0)
    np.testing.assert_allclose(batch.return_[0, kind == Kind.DELAY], GAMMA)
    np.testing.assert_allclose(batch.return_[1, kind == Kind.DELAY], 1.0)


def test_a_time_limit_is_an_end_where_nobody_looks_beyond_it():
    agent = make(window=2)
    learner = dataclasses.replace(agent.learner, looks_beyond_limit=False)
    agent = dataclasses.replace(agent, learner=learner)

    @jax.jit
    def collect():
        state = agent.init(jax.random.key(0))
        return jax.vmap(agent.collect, (None, 0, 0), (0, 1, 0))(
            state.params, state.env_state, state.keys
        )[1]

    batch = collect()
    is_cut = batch.encoding[0, :, Kind.CUT] == 1.0
    np.testing.assert_allclose(batch.return_[:, is_cut].T, [[1.0 + GAMMA, 1.0]] * int(is_cut.sum()))


def test_gradient_follows_algorithm_1(collected):
    agent, params, batch, _ = collected

    def looped(params):
        logits, value = jax.vmap(jax.vmap(agent.network.apply, (None, 0)), (None, 0))(
            params, batch.encoding
        )
        total = 0.0
        for worker in range(4):
            for t in range(3):
                log_probability = jax.nn.log_softmax(logits[t, worker])[batch.action[t, worker]]
                error = batch.return_[t, worker] - value[t, worker]
                term = 0.25 * error**2 - log_probability * batch.advantage[t, worker]
                total += batch.weight[t, worker] * term / 4
        return total

    few = jax.tree.map(lambda x: x[:, :4], batch)
    actual, _ = jax.jit(agent.gradient)(params, few, jnp.int32(0))
    assert_close(actual, jax.jit(jax.grad(looped))(params))


def test_gradient_of_the_mean_is_the_mean_of_the_workers_gradients(collected):
    agent, params, batch, _ = collected
    once, _ = jax.jit(agent.gradient)(params, batch, jnp.int32(0))
    alone = jax.tree.map(lambda x: x[:, :, None], batch)
    each, _ = jax.jit(jax.vmap(agent.gradient, (None, 1, None)))(params, alone, jnp.int32(0))
    assert_close(once, jax.tree.map(lambda x: x.mean(0), each))


def test_entropy_fades_from_its_start_to_its_end(collected):
    agent, params, batch, _ = collected
    options = {"entropy": 1.0, "entropy_end": 0.0, "num_updates": 10}
    fading = dataclasses.replace(agent, learner=dataclasses.replace(agent.learner, **options))
    plain, _ = jax.jit(agent.gradient)(params, batch, jnp.int32(0))
    gradient = jax.jit(fading.gradient)
    first, middle, last = (gradient(params, batch, jnp.int32(step))[0] for step in (0, 5, 10))
    assert_close(last, plain)
    assert_close(middle, jax.tree.map(lambda x, y: (x + y) / 2, first, last))
    assert not np.allclose(first["params"]["Dense_1"]["bias"], last["params"]["Dense_1"]["bias"])


def test_each_worker_has_a_stream_that_does_not_depend_on_their_number():
    few = make()
    many = dataclasses.replace(few, learner=dataclasses.replace(few.learner, num_workers=128))

    def streams(agent):
        return jax.jit(lambda: jax.random.key_data(agent.init(jax.random.key(0)).keys))()

    np.testing.assert_array_equal(streams(few), streams(many)[:NUM_WORKERS])
    assert len(np.unique(streams(many), axis=0)) == 128


def test_compiles_once_and_the_same_start_gives_the_same_result(trained):
    assert trained.num_compiled == 1
    assert trained.first.num_updates == 100
    if trained.window is not None:
        assert trained.first.num_decisions == 100 * 2 * NUM_WORKERS
    jax.tree.map(np.testing.assert_array_equal, trained.first.params, trained.again.params)


def test_an_action_is_a_sample_or_the_most_likely():
    agent = make()
    obs = probe_envs.observe(Kind.ACTION, 1.0)
    params = jax.jit(agent.network.init)(jax.random.key(0), obs)
    params["params"]["Dense_1"]["bias"] = jnp.array([0.0, 0.0, 0.7, 0.0])
    keys = jax.random.split(jax.random.key(0), 256)
    sample = functools.partial(peg_a2c.sample, agent.network, params, obs)
    sampled = jax.jit(jax.vmap(sample))(keys)
    assert sampled.dtype == jnp.int32
    assert set(np.asarray(sampled)) == {0, 1, 2, 3}
    assert np.bincount(sampled).argmax() == peg_a2c.mode(agent.network, params, obs)


def assert_close(actual, expected):
    """Compares two trees of gradients."""
    jax.tree.map(
        lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-4, atol=1e-6), actual, expected
    )
