"""PEG-A2C: synchronous advantage actor-critic over many workers (paper, Algorithm 1, Appendix B).

Each worker acts with the same parameters; the gradient is the mean over workers of the mean over
each worker's decisions. A gradient of a mean is the mean of the gradients, so a device does one
backward pass over all of its workers, and `pmean` averages over devices. Every random number comes
from the stream of its worker, which is derived from the worker's global index: how workers are
spread over devices changes nothing but rounding.

A network may have two halves: `encode`, from observation to encoding, and `predict`, from encoding
to logits and value. Encodings are then kept while acting, and learning, which uses the parameters
that acted, computes only the second half again.
"""

import dataclasses
from typing import TypeAlias, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key, PyTree

from eihrl_jax import base
from eihrl_jax.agents import devices, optimisation
from eihrl_jax.config import high
from eihrl_jax.ops import losses, returns, tree

Obs: TypeAlias = PyTree[Array]
"""An observation, of any structure."""

Encoding: TypeAlias = PyTree[Array]
"""What `encode` returns; of a network without halves, the observation itself."""

Counts: TypeAlias = dict[str, Float[Array, ""]]
"""Numbers of decisions and episodes, and sums of the environment's metrics."""


class LearnerState(struct.PyTreeNode):
    """All that a run needs to continue. W: workers.

    Attributes:
      params: parameters of the network.
      opt_state: state of the optimiser.
      env_state: each worker's environment; unused where every update takes whole episodes.
      keys: each worker's stream.
      num_updates: updates so far.
      num_decisions: decisions of all workers so far.
    """

    params: base.Params
    opt_state: optax.OptState
    env_state: base.EnvState
    keys: Key[Array, " W"]
    num_updates: Int[Array, ""]
    num_decisions: Int[Array, ""]


class Decision(struct.PyTreeNode):
    """One decision of a worker, or with a leading axis T a worker's decisions.

    Attributes:
      encoding: of the observation.
      action: index of the subgoal.
      value: V(obs) of the acting parameters.
      reward: unitless.
      terminated: the episode ended for good with this decision.
      truncated: the time limit cut the episode after this decision.
      is_counted: whether it belongs to the episode; false after the end of a whole episode.
      metrics: the environment's.
    """

    encoding: Encoding
    action: Int[Array, ""]
    value: Float[Array, ""]
    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    truncated: Bool[Array, ""]
    is_counted: Bool[Array, ""]
    metrics: dict[str, Float[Array, ""]]


class Batch(struct.PyTreeNode):
    """A worker's T decisions with their targets.

    Attributes:
      encoding: of the observation.
      action: index of the subgoal.
      return_: return from the decision on, R_j in the paper.
      advantage: return_ - V(obs) of the acting parameters.
      weight: 1 / t_i for the t_i decisions that count, 0 for the others; sums to 1.
    """

    encoding: Encoding
    action: Int[Array, " T"]
    return_: Float[Array, " T"]
    advantage: Float[Array, " T"]
    weight: Float[Array, " T"]


def sample(
    network: nn.Module, params: base.Params, obs: Obs, key: Key[Array, ""]
) -> Int[Array, ""]:
    """Draws the subgoal for one observation."""
    logits, _ = network.apply(params, obs)
    return jax.random.categorical(key, logits).astype(jnp.int32)


def mode(network: nn.Module, params: base.Params, obs: Obs) -> Int[Array, ""]:
    """Returns the most likely subgoal for one observation."""
    logits, _ = network.apply(params, obs)
    return jnp.argmax(logits).astype(jnp.int32)


@dataclasses.dataclass(frozen=True)
class PegA2C:
    """The learner of one environment; its methods are pure functions.

    Attributes:
      env: resets itself if and only if `learner.window` is set.
      network: maps an observation to logits and value.
      learner: its numbers.
      horizon: decisions per worker and update: `learner.window`, or the time limit of the episodes.
        With a window it must not exceed the time limit: a worker can be cut once per window.
    """

    env: base.Environment
    network: nn.Module
    learner: high.Learner
    horizon: int

    def init(self, key: Key[Array, ""]) -> LearnerState:
        """Makes the first state, all workers of the run in it."""
        # A worker's stream follows from its global index, whichever device it is on.
        params_key, workers_key = jax.random.split(key)
        streams = jax.vmap(jax.random.fold_in, (None, 0))(
            workers_key, jnp.arange(self.learner.num_workers)
        )
        reset_keys, keys = jax.vmap(jax.random.split, out_axes=1)(streams)

        env_state = jax.vmap(self.env.reset)(reset_keys)
        # The network takes one observation, not a batch: workers come by `vmap`.
        params = self.network.init(params_key, jax.tree.map(lambda x: x[0], env_state.obs))
        return LearnerState(
            params=params,
            opt_state=self._optimiser().init(params),
            env_state=env_state,
            keys=keys,
            num_updates=jnp.int32(0),
            num_decisions=jnp.int32(0),
        )

    def update(self, state: LearnerState) -> tuple[LearnerState, dict[str, Float[Array, ""]]]:
        """Lets this device's workers act, and takes a step along all devices' mean gradient.

        It must run inside a `shard_map` over `devices.AXIS`.

        Returns:
          The next state, and metrics over all devices: `decisions` counts decisions, `episodes`
          those that ended, `sum_<name>` adds the environment's metrics over these, and all others
          are means over decisions.

        Source: paper, Algorithm 1, lines 4 to 19.
        """
        # Paper: Algorithm 1, lines 7 to 14: every worker acts with the same parameters.
        rollout_keys, keys = jax.vmap(jax.random.split, out_axes=1)(state.keys)
        env_state, batch, counts = jax.vmap(self.collect, (None, 0, 0), (0, 1, 0))(
            state.params, state.env_state, rollout_keys
        )

        # Paper: Algorithm 1, lines 15 and 16, and the average over all workers: `gradient` is the
        # mean over this device's workers, `pmean` that over devices, which have as many each.
        gradient, metrics = self.gradient(state.params, batch, state.num_updates)
        gradient, metrics = jax.lax.pmean((gradient, metrics), devices.AXIS)
        counts = jax.lax.psum(jax.tree.map(jnp.sum, counts), devices.AXIS)

        params, opt_state = optimisation.step(
            self._optimiser(), gradient, state.opt_state, state.params
        )
        metrics |= counts | {"grad_norm": optax.tree.norm(gradient)}
        state = state.replace(
            params=params,
            opt_state=opt_state,
            env_state=env_state,
            keys=keys,
            num_updates=state.num_updates + 1,
            num_decisions=state.num_decisions + counts["decisions"].astype(jnp.int32),
        )
        return state, metrics

    def collect(
        self, params: base.Params, env_state: base.EnvState, key: Key[Array, ""]
    ) -> tuple[base.EnvState, Batch, Counts]:
        """Lets one worker act for one update: one window, or one whole episode.

        Returns:
          Its environment, its batch, and the counts described at `update`.

        Source: paper, Algorithm 1, lines 7 to 14.
        Differs from the paper: with a window, returns are bootstrapped from the value at the
          window's end and, with `looks_beyond_limit`, from the value at the time limit.
        """
        if self.learner.window is None:
            return self.collect_episode(params, key)

        env_state, cut_obs, decisions = self._decide(params, env_state, key)
        # A window may end amid an episode: the value stands for the return of its rest.
        _, end_value = self._predict(params, self._encode(params, env_state.obs))
        cut_value = jnp.float32(0.0)
        if self.learner.looks_beyond_limit:
            _, cut_value = self._predict(params, self._encode(params, cut_obs))
        return env_state, self._batch(decisions, end_value, cut_value), _counts(decisions)

    def collect_episode(
        self, params: base.Params, key: Key[Array, ""], *, greedy: bool = False
    ) -> tuple[base.EnvState, Batch, Counts]:
        """Lets one worker act for one whole episode; returns the same as `collect`.

        Args:
          params: parameters of the network.
          key: consumed.
          greedy: take the most likely subgoals instead of samples, which learning needs.
        """
        reset_key, act_key = jax.random.split(key)
        start = self.env.reset(reset_key)
        env_state, _, decisions = self._decide(params, start, act_key, greedy=greedy)
        # A whole episode ends by its goals or its time limit: no return is expected after either.
        zero = jnp.float32(0.0)
        return env_state, self._batch(decisions, zero, zero), _counts(decisions)

    def gradient(
        self, params: base.Params, batch: Batch, num_updates: Int[Array, ""]
    ) -> tuple[base.Params, dict[str, Float[Array, ""]]]:
        """Computes the gradient of the workers' mean loss.

        It is accumulated over the T steps, one backward pass for all workers at a time, because a
        batch that stays in the processor's cache takes about half the time per decision (two cores,
        1024 workers: 3.0 instead of 5.5 microseconds).

        Args:
          params: parameters of the network.
          batch: with axes [T, W], the workers' decisions.
          num_updates: updates so far, for the entropy's schedule.

        Returns:
          The gradient, and means over the decisions.

        Source: paper, Algorithm 1, lines 15 and 16; signs such that descent improves both terms.
        Differs from the paper: an entropy bonus, and a weight on the value's error.
        """
        progress = num_updates.astype(jnp.float32) / self.learner.num_updates
        entropy_coef = self.learner.entropy + progress * (
            self.learner.entropy_end - self.learner.entropy
        )

        def mean_loss(params, decisions):
            terms = jax.vmap(self._loss_terms, (None, 0))(params, decisions)
            means = {name: jnp.mean(decisions.weight * term) for name, term in terms.items()}
            loss = means["policy_loss"] - entropy_coef * means["entropy"]
            return loss + self.learner.value_coef * means["value_loss"], means

        # A worker's weights sum to 1 over its steps: so steps are added, and workers averaged.
        def add_step(total, decisions):
            step = jax.grad(mean_loss, has_aux=True)(params, decisions)
            return jax.tree.map(jnp.add, total, step), None

        names = ("policy_loss", "value_loss", "entropy")
        zero = (jax.tree.map(jnp.zeros_like, params), dict.fromkeys(names, jnp.float32(0.0)))
        total, _ = jax.lax.scan(add_step, zero, batch)
        return total

    def _decide(
        self,
        params: base.Params,
        env_state: base.EnvState,
        key: Key[Array, ""],
        *,
        greedy: bool = False,
    ) -> tuple[base.EnvState, Obs | None, Decision]:
        """Lets one worker make its decisions.

        Returns:
          Its environment, the observation at the last time limit (None unless the learner looks
          beyond it), and the decisions.
        """
        has_window = self.learner.window is not None
        looks_beyond = has_window and self.learner.looks_beyond_limit

        def decide(carry, step_key):
            env_state, is_running, cut_obs = carry
            encoding = self._encode(params, env_state.obs)
            logits, value = self._predict(params, encoding)
            drawn = logits.argmax() if greedy else jax.random.categorical(step_key, logits)
            action = drawn.astype(jnp.int32)
            following = self.env.step(env_state, action)
            decision = Decision(
                encoding=encoding,
                action=action,
                value=value,
                reward=following.reward,
                terminated=following.terminated,
                truncated=following.truncated,
                is_counted=is_running,
                metrics=following.metrics,
            )

            # After the end of a whole episode nothing counts; a window goes on in the next one.
            is_running &= has_window | ~following.is_over
            if looks_beyond:
                cut_obs = tree.where(following.truncated, following.final_obs, cut_obs)
            else:  # Unused: so XLA needn't draw the picture.
                following = following.replace(final_obs=following.obs)
            return (following, is_running, cut_obs), decision

        start = (env_state, jnp.array(True), env_state.obs if looks_beyond else None)
        (env_state, _, cut_obs), decisions = jax.lax.scan(
            decide, start, jax.random.split(key, self.horizon)
        )
        return env_state, cut_obs, decisions

    def _encode(self, params: base.Params, obs: Obs) -> Encoding:
        """Applies the network's first half, if it has one."""
        if not hasattr(self.network, "encode"):
            return obs
        return cast(Encoding, self.network.apply(params, obs, method="encode"))

    def _predict(
        self, params: base.Params, encoding: Encoding
    ) -> tuple[Float[Array, "4"], Float[Array, ""]]:
        """Returns the logits of the subgoals and the value, from what `_encode` returned."""
        method = "predict" if hasattr(self.network, "predict") else None
        return cast(tuple[Array, Array], self.network.apply(params, encoding, method=method))

    def _loss_terms(self, params: base.Params, decision: Batch) -> dict[str, Float[Array, ""]]:
        """Computes the terms of the loss for one decision."""
        logits, value = self._predict(params, decision.encoding)
        return {
            "policy_loss": losses.policy_gradient(logits, decision.action, decision.advantage),
            "value_loss": losses.value_error(value, decision.return_),
            "entropy": losses.entropy(logits),
        }

    def _batch(
        self, decisions: Decision, end_value: Float[Array, ""], cut_value: Float[Array, ""]
    ) -> Batch:
        """Computes returns, advantages and weights of one worker's decisions.

        Args:
          decisions: with axis T.
          end_value: value after the last decision.
          cut_value: value of the observation at the time limit.
        """
        is_counted, terminated, truncated = (
            x.astype(jnp.float32)
            for x in (decisions.is_counted, decisions.terminated, decisions.truncated)
        )

        # Paper: Algorithm 1, lines 12 to 14, where lambda is 1 and no value is bootstrapped.
        following_value = jnp.append(decisions.value[1:], end_value)
        return_ = returns.lambda_returns(
            decisions.reward * is_counted,
            self.learner.gamma * (1.0 - terminated),
            jnp.where(decisions.truncated, cut_value, following_value),
            # After a time limit comes another episode, whose return isn't part of this one's.
            self.learner.lambda_ * (1.0 - truncated),
        )

        return Batch(
            encoding=decisions.encoding,
            action=decisions.action,
            return_=return_,
            advantage=return_ - decisions.value,
            weight=is_counted / is_counted.sum(),
        )

    def _optimiser(self) -> optax.GradientTransformation:
        learner = self.learner
        rate = optax.linear_schedule(
            learner.learning_rate, learner.learning_rate_end, learner.num_updates
        )
        rule = {"rmsprop": optax.rmsprop(rate, decay=0.99, eps=1e-5), "adam": optax.adam(rate)}
        return optax.chain(
            optax.clip_by_global_norm(learner.max_grad_norm), rule[learner.optimiser]
        )


def _counts(decisions: Decision) -> Counts:
    """Counts one worker's decisions and ended episodes, and adds up the metrics of the latter."""
    # After the end of a whole episode nothing counts, so that it ends only once.
    is_end = decisions.is_counted & (decisions.terminated | decisions.truncated)
    sums = {f"sum_{name}": jnp.sum(x, where=is_end) for name, x in decisions.metrics.items()}
    counts = {"decisions": decisions.is_counted, "episodes": is_end}
    return sums | {name: jnp.sum(x, dtype=jnp.float32) for name, x in counts.items()}
