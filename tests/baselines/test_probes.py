"""Every learner finds the values and actions of problems so small that both are known.

As in `tests.agents.probe_envs`, all problems are put to one learner at once, but as transitions,
with actions drawn uniformly: what is tested is how a learner learns from its replay. Costs instead
of rewards, since HESS's controller has no values above 0.
"""

import dataclasses
import enum
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.agents import droq
from eihrl_jax.baselines.hess import levels
from eihrl_jax.baselines.higl import td3
from eihrl_jax.config import hess, higl, low

GAMMA = 0.5
BATCH = 128


class Kind(enum.IntEnum):
    """What a transition is about; the cue is -1 or 1, the action a lies in [-1, 1]."""

    CONSTANT = 0
    """Costs 1, then the end: Q = -1."""
    CUE = 1
    """Costs 1 at cue -1, then the end: Q = -1 or 0."""
    DELAY = 2
    """Costs nothing, then comes `LATE`: Q = -gamma."""
    LATE = 3
    """Costs 1, then the end: Q = -1."""
    ACTION = 4
    """Costs (a - 0.5)^2, then the end: Q = 0 for the best policy."""
    CUE_AND_ACTION = 5
    """Costs (a - cue / 2)^2, then the end: Q = 0 for the best policy."""
    ENDED = 6
    """Costs 1/2, then the end: Q = -1/2."""
    CUT = 7
    """Costs 1/2 for ever, as a time limit that isn't looked at: Q = -1 / (2 (1 - gamma))."""


def observe(kind, cue):
    """Returns what a transition shows: its kind and its cue."""
    return jnp.concatenate([jax.nn.one_hot(kind, len(Kind)), cue[..., None]], -1)


def transitions(key):
    """Draws a batch of all kinds."""
    kind_key, cue_key, action_key = jax.random.split(key, 3)
    kind = jax.random.randint(kind_key, (BATCH,), 0, len(Kind))
    cue = jnp.where(jax.random.bernoulli(cue_key, shape=(BATCH,)), jnp.float32(1), jnp.float32(-1))
    action = jax.random.uniform(action_key, (BATCH, 1), minval=-1.0, maxval=1.0)
    costs = {
        Kind.CONSTANT: jnp.ones(BATCH),
        Kind.CUE: 0.5 * (1.0 - cue),
        Kind.DELAY: jnp.zeros(BATCH),
        Kind.LATE: jnp.ones(BATCH),
        Kind.ACTION: jnp.square(action[:, 0] - 0.5),
        Kind.CUE_AND_ACTION: jnp.square(action[:, 0] - 0.5 * cue),
        Kind.ENDED: jnp.full(BATCH, 0.5),
        Kind.CUT: jnp.full(BATCH, 0.5),
    }
    cost = jnp.stack([costs[each] for each in Kind])[kind, jnp.arange(BATCH)]
    goes_on = (kind == Kind.DELAY) | (kind == Kind.CUT)
    return base.Transition(
        obs=observe(kind, cue),
        action=action,
        reward=-cost,
        discount=GAMMA * goes_on.astype(jnp.float32),
        next_obs=observe(jnp.where(kind == Kind.DELAY, Kind.LATE, kind), cue),
    )


@dataclasses.dataclass(frozen=True)
class Learner:
    """A learner seen from here; `value` of [B] observations with actions, `act` for one."""

    init: Callable[[jax.Array], Any]
    update: Callable[[Any, base.Transition, jax.Array], tuple[Any, dict]]
    act: Callable[[Any, jax.Array], jax.Array]
    value: Callable[[Any, jax.Array, jax.Array], jax.Array]


def make(name):
    """Returns a small learner by name."""
    size, key, weight = len(Kind) + 1, jax.random.key(9), jnp.ones(BATCH)
    if name == "droq":
        options = low.Droq(
            hidden=(64, 64),
            learning_rate=3e-3,
            temperature=1e-3,
            target_rate=0.05,
            actor_period=1,
            gamma=GAMMA,
        )
        agent = droq.Droq(size, 1, options)
        return Learner(
            agent.init,
            agent.update,
            lambda state, obs: agent.mode(state.actor_params, obs),
            lambda state, obs, act: agent.values(state.critic_params, obs, act, key).mean(0),
        )
    if name == "td3":
        options = higl.Td3(
            hidden=(64, 64), actor_rate=1e-3, target_rate=0.05, target_noise=0.02, target_clip=0.05
        )
        agent = td3.Td3(size, 1, options)
        return Learner(
            agent.init,
            lambda state, batch, key: agent.update(state, batch, weight, key),
            lambda state, obs: agent.act(state.actor.params, obs),
            lambda state, obs, act: agent.values(state.critics.params, obs, act).mean(0),
        )
    if name == "hess, upper level":
        options = hess.Sac(
            hidden=(64, 64), reach=2.0, learning_rate=3e-3, temperature=1e-3, target_rate=0.05
        )
        agent = levels.Sac(size, 1, options)
        return Learner(
            agent.init,
            lambda state, batch, key: agent.update(state, batch, weight, key),
            lambda state, obs: agent.mode(state.actor.params, obs),
            lambda state, obs, act: agent.values(state.critics.params, obs, act).mean(0),
        )
    options = hess.Ddpg(
        hidden=(64, 64), critic_hidden=(64, 64), learning_rate=2e-3, gamma=GAMMA, target_rate=0.2
    )
    agent = levels.Ddpg(size, 1, options)
    return Learner(
        agent.init,
        lambda state, batch, key: agent.update(state, batch, weight, jnp.float32(1.0)),
        lambda state, obs: agent.act(state.actor.params, obs),
        lambda state, obs, act: agent.values(state.critics.params, obs, act)[0],
    )


@pytest.fixture(scope="module", params=["droq", "td3", "hess, upper level", "hess, lower level"])
def trained(request):
    """Returns a learner, and its state after training on all kinds at once."""
    learner = make(request.param)
    learner = dataclasses.replace(learner, act=jax.jit(learner.act), value=jax.jit(learner.value))

    def body(state, key):
        draw_key, update_key = jax.random.split(key)
        return learner.update(state, transitions(draw_key), update_key)[0], None

    @jax.jit
    def train():
        keys = jax.random.split(jax.random.key(1), 2_000)
        return jax.lax.scan(body, learner.init(jax.random.key(0)), keys)[0]

    return learner, train()


def value(trained, kind, cue=1.0, action=None):
    """Returns the value of an action, its own by default."""
    learner, state = trained
    obs = observe(jnp.int32(kind), jnp.float32(cue))
    act = learner.act(state, obs) if action is None else jnp.array([action])
    return float(learner.value(state, obs[None], act[None])[0])


close = functools.partial(pytest.approx, abs=0.12)


def test_a_constant_cost(trained):
    assert value(trained, Kind.CONSTANT) == close(-1.0)


@pytest.mark.parametrize(("cue", "expected"), [(-1.0, -1.0), (1.0, 0.0)])
def test_a_cost_that_the_observation_tells(trained, cue, expected):
    assert value(trained, Kind.CUE, cue) == close(expected)


def test_a_cost_one_step_later_is_discounted_once(trained):
    assert value(trained, Kind.LATE) == close(-1.0)
    assert value(trained, Kind.DELAY) == close(-GAMMA)


def test_the_action_that_costs_nothing_is_found(trained):
    learner, state = trained
    found = learner.act(state, observe(jnp.int32(Kind.ACTION), jnp.float32(1.0)))
    assert float(found[0]) == pytest.approx(0.5, abs=0.15)
    assert value(trained, Kind.ACTION) == close(0.0)
    assert value(trained, Kind.ACTION, action=-0.5) == close(-1.0)


def test_the_action_that_the_observation_asks_for_is_found(trained):
    learner, state = trained
    for cue in (-1.0, 1.0):
        found = learner.act(state, observe(jnp.int32(Kind.CUE_AND_ACTION), jnp.float32(cue)))
        assert float(found[0]) == pytest.approx(0.5 * cue, abs=0.15)


def test_an_end_is_told_from_a_time_limit(trained):
    assert value(trained, Kind.ENDED) == close(-0.5)
    assert value(trained, Kind.CUT) == close(-0.5 / (1.0 - GAMMA))
    np.testing.assert_array_less(value(trained, Kind.CUT), value(trained, Kind.ENDED) - 0.3)
