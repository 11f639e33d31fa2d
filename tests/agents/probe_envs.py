"""Environments so small that their value functions are known, to find what a learner gets wrong.

All of them are one environment that draws its kind anew in every episode and shows it, so that one
compiled learner is put to all of them at once. The idea: Andy Jones, "Debugging RL, Without the
Agonizing Pain" (2021).
"""

import dataclasses
import enum

import jax
import jax.numpy as jnp
from flax import struct

from eihrl_jax import base


class Kind(enum.IntEnum):
    """What an episode is about; gamma is the learner's discount."""

    CONSTANT = 0
    """One step, reward 1: V = 1."""
    CUE = 1
    """One step, the reward is the cue, -1 or 1: V = cue."""
    DELAY = 2
    """Two steps, reward 1 after the second: V = gamma, then 1."""
    ACTION = 3
    """One step, reward 1 for action 2: V = 1 for the best policy."""
    CUE_AND_ACTION = 4
    """One step, reward 1 for action 0 at cue -1 and 1 at cue 1: V = 1 for the best policy."""
    ENDED = 5
    """Reward 1 for each of two steps that look alike, then the end: V = 1 + gamma / 2, the mean."""
    CUT = 6
    """The same, but a time limit: V = 1 / (1 - gamma) for who looks beyond it, else as ENDED."""


TWO_STEPS = (Kind.DELAY, Kind.ENDED, Kind.CUT)


@struct.dataclass
class ProbeState:
    """Kind of the episode, steps taken in it, its cue, and its rewards so far."""

    kind: jax.Array
    step: jax.Array
    cue: jax.Array
    total: jax.Array


@dataclasses.dataclass(frozen=True)
class Probe:
    """Observation: [kind one-hot (7), cue, second step of DELAY], unitless; four actions."""

    length: int = 2

    def reset(self, key):
        """Draws kind and cue."""
        key, kind_key, cue_key = jax.random.split(key, 3)
        inner = ProbeState(
            kind=jax.random.randint(kind_key, (), 0, len(Kind)),
            step=jnp.int32(0),
            cue=jnp.where(jax.random.bernoulli(cue_key), jnp.float32(1.0), jnp.float32(-1.0)),
            total=jnp.float32(0.0),
        )
        obs = observe(inner.kind, inner.cue, inner.step)
        return base.EnvState(
            inner=inner,
            obs=obs,
            final_obs=obs,
            reward=jnp.float32(0.0),
            terminated=jnp.array(False),
            truncated=jnp.array(False),
            metrics={"return": inner.total},
            key=key,
        )

    def step(self, state, action):
        """Pays, and counts the step."""
        inner = state.inner
        is_second = inner.step == 1
        wanted = jnp.where(inner.cue > 0, 1, 0)
        rewards = {
            Kind.CONSTANT: jnp.float32(1.0),
            Kind.CUE: inner.cue,
            Kind.DELAY: is_second.astype(jnp.float32),
            Kind.ACTION: (action == 2).astype(jnp.float32),
            Kind.CUE_AND_ACTION: (action == wanted).astype(jnp.float32),
            Kind.ENDED: jnp.float32(1.0),
            Kind.CUT: jnp.float32(1.0),
        }
        reward = jnp.stack([rewards[kind] for kind in Kind])[inner.kind]
        is_long = jnp.array([kind in TWO_STEPS for kind in Kind])[inner.kind]
        is_over = is_second | ~is_long
        inner = inner.replace(step=inner.step + 1, total=inner.total + reward)
        obs = observe(inner.kind, inner.cue, inner.step)
        return state.replace(
            inner=inner,
            obs=obs,
            final_obs=obs,
            reward=reward,
            terminated=is_over & (inner.kind != Kind.CUT),
            truncated=is_over & (inner.kind == Kind.CUT),
            metrics={"return": inner.total},
        )


def observe(kind, cue, step=0):
    """Returns what an episode shows."""
    is_late = jnp.where((kind == Kind.DELAY) & (step == 1), 1.0, 0.0)
    one_hot = (jnp.arange(len(Kind)) == kind).astype(jnp.float32)
    return jnp.concatenate([one_hot, jnp.stack([jnp.float32(cue), is_late])])
