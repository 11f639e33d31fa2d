"""Flat DroQ: one level, from where the robot and its goal are to its controls (paper, Sec. 4.3).

The learner is that of our low level, `agents.droq`, with the task's own reward.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.agents import droq, optimisation, replay
from eihrl_jax.baselines import periods
from eihrl_jax.baselines.world import World
from eihrl_jax.config import baselines as config_lib


class FlatState(struct.PyTreeNode):
    """Everything needed to resume a run. N: number of environments.

    Attributes:
      learner: networks and optimisers.
      replay: `base.Transition`s.
      envs: environments with leading axis N.
      key: of what comes next.
      num_steps: int32, control steps of all environments so far.
    """

    learner: droq.DroqState
    replay: replay.Replay
    envs: base.EnvState
    key: Key[Array, ""]
    num_steps: Int[Array, ""]


class FlatDroq:
    """The functions of a run; has no mutable state.

    Attributes:
      options: of the run.
      steps_per_round: control steps of all environments in a round.
    """

    def __init__(self, world: World, options: config_lib.FlatConfig):
        """Builds the learner."""
        self.options = options
        self.steps_per_round = options.steps_per_round
        self._world = world
        num_features = world.num_features(self.see)
        self._learner = droq.Droq(num_features, world.num_actions, options.learner)

    def init(self, key: Key[Array, ""]) -> FlatState:
        """Returns the initial state of a run, with an empty replay."""
        key, learner_key, env_key = jax.random.split(key, 3)
        envs = self._world.reset(self.options.num_envs, env_key)
        action = jnp.zeros((self.options.num_envs, self._world.num_actions))

        # The step is only traced: it tells what a row of the replay holds.
        rows = jax.eval_shape(self._step, envs, action)[1]
        return FlatState(
            learner=self._learner.init(learner_key),
            replay=replay.init(replay.row(rows), self.options.capacity, self.options.num_envs),
            envs=envs,
            key=key,
            num_steps=jnp.int32(0),
        )

    def advance(self, state: FlatState) -> tuple[FlatState, dict[str, Float[Array, ""]]]:
        """Takes some steps in every environment, each followed by its updates.

        Returns:
          The new state, and scalars: means of what the learner tells, and sums over the episodes
          that ended, their names beginning with `sum_`.
        """
        state, (learned, sums) = jax.lax.scan(
            self._iterate, state, length=self.options.iterations_per_round
        )
        metrics = optimisation.means("learner", learned)
        return state, metrics | {name: value.sum() for name, value in sums.items()}

    def policy(self, state: FlatState) -> dict[str, base.Params]:
        """Returns the parameters that act."""
        # As in our low level: what acts without exploration is the actor's average.
        return {"actor": state.learner.average_params}

    def start(self) -> tuple[()]:
        """Returns the carry at the beginning of an episode, which is empty."""
        return ()

    def act(
        self, policy: dict[str, base.Params], carry: tuple[()], obs: base.GoalObs
    ) -> tuple[Float[Array, " nu"], tuple[()]]:
        """Returns controls in [-1, 1] without exploration, and the carry of the next step."""
        return self._learner.mode(policy["actor"], self.see(obs)), carry

    def see(self, obs: base.GoalObs) -> Float[Array, "*B F"]:
        """Returns the network's input: position from the arena's centre, robot, way to the goal.

        Positions are in cells: in units, they would drown the robot in the layer normalisation.
        """
        xy, left = self._world.centred(obs.xy), obs.goal_xy - obs.xy
        return jnp.concatenate([xy / base.CELL, obs.proprioception, left / base.CELL], axis=-1)

    def _iterate(self, state: FlatState, _: None) -> tuple[FlatState, tuple[dict, dict]]:
        """Takes one step in every environment, then learns, once the warm-up is over."""
        key, act_key, random_key, draw_key, update_key = jax.random.split(state.key, 5)
        num_envs = self.options.num_envs
        is_warm = state.num_steps >= self.options.warmup_steps

        # Both actions are drawn: that the warm-up is over is only known while the program runs.
        chosen = jax.vmap(self._learner.sample, (None, 0, 0))(
            state.learner.actor_params,
            self.see(state.envs.obs),
            jax.random.split(act_key, num_envs),
        )
        random = jax.random.uniform(random_key, chosen.shape, minval=-1.0, maxval=1.0)
        envs, rows = self._step(state.envs, jnp.where(is_warm, chosen, random))

        # As many updates as all robots' steps ask for, all drawn at once: see `optimisation.loop`.
        stored = replay.add(state.replay, rows)
        count = num_envs * self.options.updates_per_step
        shape = count, self.options.learner.batch_size
        batches = self._world.draw(stored, shape, draw_key)

        def learn(learner: droq.DroqState) -> tuple[droq.DroqState, dict[str, Array]]:
            return optimisation.loop(self._learner.update, learner, batches, update_key)

        def rest(learner: droq.DroqState) -> tuple[droq.DroqState, dict[str, Array]]:
            # Both branches must return the same shapes; NaN doesn't count in the means.
            shapes = jax.eval_shape(learn, learner)[1]
            nothing = jax.tree.map(lambda leaf: jnp.full(leaf.shape, jnp.nan, leaf.dtype), shapes)
            return learner, nothing

        learner, learned = jax.lax.cond(is_warm, learn, rest, state.learner)
        state = FlatState(
            learner=learner,
            replay=stored,
            envs=envs,
            key=key,
            num_steps=state.num_steps + num_envs,
        )
        # After an auto-reset the flags and metrics are still those of the episode that ended.
        return state, (learned, periods.sum_ends(envs.is_over, envs.metrics))

    def _step(
        self, envs: base.EnvState, action: Float[Array, "N nu"]
    ) -> tuple[base.EnvState, base.Transition]:
        """Steps every environment, and returns what is to be stored of it."""
        stepped = self._world.step(envs, action)
        rows = base.Transition(
            obs=self.see(envs.obs),
            action=action,
            reward=stepped.reward,
            # A time limit is no end: what would have come after it has a value.
            discount=self.options.learner.gamma * (1.0 - stepped.terminated.astype(jnp.float32)),
            # Where the step led to: `obs` may be the beginning of the next episode.
            next_obs=self.see(stepped.final_obs),
        )
        return stepped, rows
