"""The low level's training: act, store, learn and measure (paper, Sec. 3.2)."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base, robots
from eihrl_jax.agents import devices, droq, optimisation
from eihrl_jax.agents import replay as replay_lib
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import experience, locomotion, low_obs, subgoals, wrappers
from eihrl_jax.ops import tree
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import engines, scene
from eihrl_jax.runs import progress as progress_lib
from eihrl_jax.training import parallel


class LowState(struct.PyTreeNode):
    """Everything needed to resume a run. N: number of environments.

    Attributes:
      learner: networks and optimisers.
      replay: stored steps.
      envs: states of the environments, leading axis N.
      key: for all further draws.
      iteration: int32, iterations done, each a step in every environment.
    """

    learner: droq.DroqState
    replay: replay_lib.Replay
    envs: base.EnvState
    key: Key[Array, ""]
    iteration: Int[Array, ""]


class LowTrainer:
    """The compiled functions of one run; has no mutable state."""

    def __init__(self, config: low_config.LowConfig):
        """Builds physics, environments and learner.

        Args:
          config: the run's options.

        Raises:
          base.UserError: the robot is unknown.
        """
        self.config = config
        self.robot = robots.load(config.robot)
        engine = engines.make(self.robot, config.engine)
        self._num_actions = engine.model.nu
        self.fingerprint = scene.fingerprint(
            engine.model, self.robot, full_range=config.low_input.full_range
        )

        # Statistics are always measured on open floor, also if training is in rooms.
        on_open_floor = dataclasses.replace(config, num_rooms=0, anchored=False)
        self._env, self._test_env = _task(engine, config), _task(engine, on_open_floor)

        # Sizes of the networks, without computing anything.
        obs = jax.eval_shape(self._env.reset, jax.random.key(0)).obs
        self.num_features = jax.eval_shape(self._features, obs).shape[0]
        self._learner = droq.Droq(self.num_features, self._num_actions, config.droq)

        # Robots and their stored steps are sharded over devices. From that XLA derives how batches
        # are sharded, and averages gradients.
        self._mesh = parallel.make_mesh(
            parallel.or_one_on_cpu(config.num_devices),
            num_envs=config.num_envs,
            batch_size=config.droq.batch_size,
        )

        # Bound once: JAX caches traces by function object, and `self.init` is a new one each time.
        init = self.init
        self.shapes = jax.eval_shape(init, jax.random.key(0))
        self._spread = spread = devices.shardings(self.shapes, self._mesh)
        alike = devices.sharding(self._mesh)

        # Each is compiled once, however many runs use the trainer.
        self.jit_init = jax.jit(init, out_shardings=spread, compiler_options=base.QUICK_COMPILE)
        self.jit_warm_up = jax.jit(
            self.warm_up,
            donate_argnums=0,
            static_argnums=1,
            in_shardings=(spread,),
            out_shardings=spread,
            compiler_options=base.QUICK_COMPILE,
        )
        self.jit_advance = jax.jit(
            self.advance, donate_argnums=0, in_shardings=(spread,), out_shardings=(spread, alike)
        )
        self.jit_measure = jax.jit(self.measure, static_argnums=(2, 3))
        self._jit_reset = jax.jit(
            jax.vmap(self._test_env.reset), compiler_options=base.QUICK_COMPILE
        )
        self._jit_walk = jax.jit(self._walk)

    def init(self, key: Key[Array, ""]) -> LowState:
        """Returns the initial state of a run, with an empty replay."""
        key, learner_key, env_key = jax.random.split(key, 3)
        reset = devices.over_devices(jax.vmap(self._env.reset), self._mesh)
        envs = reset(jax.random.split(env_key, self.config.num_envs))
        ctrl = jnp.zeros((self.config.num_envs, self._num_actions))

        # The replay's row shapes come from a step that is only traced.
        stored = jax.eval_shape(self._step, envs, ctrl)[1]
        return LowState(
            learner=self._learner.init(learner_key),
            replay=replay_lib.init(
                replay_lib.row(stored), self.config.capacity, self.config.num_envs
            ),
            envs=envs,
            key=key,
            iteration=jnp.int32(0),
        )

    def warm_up(self, state: LowState, num_iterations: int) -> LowState:
        """Stores `num_iterations` steps per environment, with controls uniform in [-1, 1]."""

        def body(state: LowState, _: None) -> tuple[LowState, None]:
            key, ctrl_key = jax.random.split(state.key)
            shape = (self.config.num_envs, self._num_actions)
            ctrl = jax.random.uniform(ctrl_key, shape, minval=-1.0, maxval=1.0)
            envs, stored = self._step(state.envs, ctrl)
            replay = replay_lib.add(state.replay, stored)
            return state.replace(envs=envs, replay=replay, key=key), None

        return jax.lax.scan(body, state, length=num_iterations)[0]

    def advance(self, state: LowState) -> tuple[LowState, dict[str, Float[Array, ""]]]:
        """Runs `log_every` iterations: each is one step in every environment, then updates.

        Returns:
          The new state, and the metrics of learner and subgoals, averaged over the iterations.
        """
        length = self.config.log_every
        state, (learned, stepped) = jax.lax.scan(self._iterate, state, length=length)
        return state, optimisation.means("learner", learned) | subgoals.summarise(stepped)

    def sample(
        self, actor_params: base.Params, obs: low_obs.LowObs, key: Key[Array, ""]
    ) -> Float[Array, " nu"]:
        """Samples the controls of one robot, in [-1, 1]."""
        action = self._learner.sample(actor_params, self._features(obs), key)
        return low_obs.ctrl_from_action(action, obs, self.robot, self.config.low_input)

    def mode(self, actor_params: base.Params, obs: low_obs.LowObs) -> Float[Array, " nu"]:
        """Returns the deterministic controls of one robot, in [-1, 1]."""
        action = self._learner.mode(actor_params, self._features(obs))
        return low_obs.ctrl_from_action(action, obs, self.robot, self.config.low_input)

    def measure(
        self,
        actor_params: base.Params,
        key: Key[Array, ""],
        num_envs: int = 64,
        num_subgoals: int = 12,
    ) -> dict[str, Float[Array, ""]]:
        """Returns the subgoal statistics of the deterministic policy on open floor."""
        envs = jax.vmap(self._test_env.reset)(self._test_keys(key, num_envs))
        length = num_subgoals * self.robot.steps_per_subgoal
        return subgoals.summarise(self._walk(envs, actor_params, length)[1][1])

    def roll(
        self,
        actor_params: base.Params,
        key: Key[Array, ""],
        num_envs: int,
        num_subgoals: int,
        progress: progress_lib.Progress,
    ) -> tuple[Float[np.ndarray, "T N nq"], dict[str, Float[np.ndarray, "T N"]]]:
        """Runs the same episodes as `measure`, and returns qpos and metrics of every step.

        Args:
          actor_params: of the policy.
          key: for starts and directions.
          num_envs: number of robots, N.
          num_subgoals: followed by each.
          progress: is told the number of subgoals that are done.

        Returns:
          Both on the host; T is `num_subgoals` times the steps per subgoal.
        """
        # Committed to a device, as the next states are: else walking is compiled a second time.
        envs = jax.device_put(
            self._jit_reset(self._test_keys(key, num_envs)), jax.local_devices()[0]
        )
        parts = []
        for number in range(1, num_subgoals + 1):
            envs, steps = self._jit_walk(envs, actor_params)
            parts.append(jax.device_get(steps))
            progress.update(number)
        qpos, metrics = jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
        return qpos, metrics

    def postures(self, qpos: Float[np.ndarray, "T N nq"]) -> Float[np.ndarray, "K nq"]:
        """Picks `num_postures` postures, spread evenly over time and robots (paper, Sec. 3.2).

        Args:
          qpos: what `roll` returned.

        Returns:
          Positions as in MuJoCo's qpos with x = y = 0; none from the first subgoal.
        """
        # During the first subgoal the robot still starts from the reset's noise.
        qpos = qpos[self.robot.steps_per_subgoal :].reshape(-1, qpos.shape[-1])
        index = np.linspace(0, len(qpos) - 1, self.config.num_postures).astype(np.int32)
        picked = qpos[index]
        picked[:, :2] = 0.0
        return picked

    def meta(self) -> dict[str, Any]:
        """Returns the JSON values from which the policy can be rebuilt with its parameters."""
        return {
            "robot": self.robot.name,
            "fingerprint": self.fingerprint,
            "low_input": vars(self.config.low_input),
            "hidden": list(self.config.droq.hidden),
            "num_features": self.num_features,
            "num_actions": self._num_actions,
        }

    def place(self, state: LowState) -> LowState:
        """Moves a state to the run's devices, over which robots and stored steps are sharded."""
        return jax.device_put(state, self._spread)

    def _features(self, obs: low_obs.LowObs) -> Float[Array, " F"]:
        return low_obs.features(obs, self.robot, self.config.low_input)

    def _iterate(
        self, state: LowState, _: None
    ) -> tuple[LowState, tuple[dict[str, Array], dict[str, Array]]]:
        """Takes one step in every environment, then updates the learner."""
        key, act_key, learn_key = jax.random.split(state.key, 3)

        # Act, and store what happened.
        act_keys = jax.random.split(act_key, self.config.num_envs)
        sample = jax.vmap(self.sample, (None, 0, 0))
        ctrl = sample(state.learner.actor_params, state.envs.obs, act_keys)
        envs, stored = self._step(state.envs, ctrl)
        replay = replay_lib.add(state.replay, stored)

        # Learn. All batches are drawn before the first update, see `optimisation.loop`.
        batch_key, update_key = jax.random.split(learn_key)
        batches = self._draw(replay, self.config.updates_per_iteration, batch_key)
        learner, learned = optimisation.loop(
            self._learner.update, state.learner, batches, update_key
        )

        state = LowState(
            learner=learner, replay=replay, envs=envs, key=key, iteration=state.iteration + 1
        )
        return state, (learned, envs.metrics)

    def _step(
        self, envs: base.EnvState, ctrl: Float[Array, "N nu"]
    ) -> tuple[base.EnvState, experience.Experience]:
        """Steps every environment; also returns the steps to be stored."""

        def step(
            envs: base.EnvState, ctrl: Float[Array, "n nu"]
        ) -> tuple[base.EnvState, experience.Experience]:
            stepped = jax.vmap(self._env.step)(envs, ctrl)
            return stepped, jax.vmap(experience.of_step)(envs, ctrl, stepped)

        # Each device calls the physics for its own robots.
        return devices.over_devices(step, self._mesh)(envs, ctrl)

    def _draw(
        self, replay: replay_lib.Replay, num_batches: int, key: Key[Array, ""]
    ) -> base.Transition:
        """Draws batches with leading axes [num_batches, B], relabelled if so configured."""
        # All three keys are split off even without relabelling, so that rows stay the same.
        row_key, direction_key, share_key = jax.random.split(key, 3)
        shape = (num_batches, self.config.droq.batch_size)
        rows = replay_lib.sample(replay, shape, row_key)
        rows = devices.shard(rows, 1, self._mesh)

        if self.config.relabel != "never":
            direction = jax.random.randint(direction_key, shape, 0, base.NUM_DIRECTIONS)
            is_relabelled = jax.random.bernoulli(share_key, self.config.relabel_share, shape)
            rows = jax.vmap(jax.vmap(self._relabel))(rows, direction, is_relabelled)

        # Rewards are computed here instead of being stored, because they depend on the direction.
        transition = functools.partial(
            experience.transition,
            robot=self.robot,
            input_options=self.config.low_input,
            reward_options=self.config.reward,
            gamma=self.config.droq.gamma,
        )
        return jax.vmap(jax.vmap(transition))(rows)

    def _relabel(
        self, row: experience.Experience, direction: Int[Array, ""], is_relabelled: Bool[Array, ""]
    ) -> experience.Experience:
        """Returns a stored step as it is, or as it would have been with another subgoal."""
        if self.config.relabel == "direction":
            relabelled = experience.relabel(row, direction)
        else:
            relabelled = experience.restart(row, direction, self.robot)
        return tree.where(is_relabelled, relabelled, row)

    def _test_keys(self, key: Key[Array, ""], num_envs: int) -> Key[Array, " N"]:
        """Returns the keys of the robots that are measured."""
        env_key, _ = jax.random.split(key)  # The split keeps draws equal to earlier versions'.
        return jax.random.split(env_key, num_envs)

    def _walk(
        self, envs: base.EnvState, actor_params: base.Params, num_steps: int | None = None
    ) -> tuple[base.EnvState, tuple[Float[Array, "T N nq"], dict[str, Float[Array, "T N"]]]]:
        """Runs the deterministic policy; returns states, and qpos and metrics of every step.

        Args:
          envs: states of robots on open floor.
          actor_params: of the policy.
          num_steps: control steps; None: those of a subgoal.
        """

        def body(envs: base.EnvState, _: None) -> tuple[base.EnvState, tuple[Array, dict]]:
            ctrl = jax.vmap(self.mode, (None, 0))(actor_params, envs.obs)
            envs = jax.vmap(self._test_env.step)(envs, ctrl)
            return envs, (envs.inner.physics.qpos, envs.metrics)

        length = self.robot.steps_per_subgoal if num_steps is None else num_steps
        return jax.lax.scan(body, envs, length=length)


class _Task(NamedTuple):
    """An environment's functions. Jitted, each is traced once for all programs it is part of."""

    reset: Callable[[Key[Array, ""]], base.EnvState]
    step: Callable[[base.EnvState, Float[Array, " nu"]], base.EnvState]


def _task(engine: engine_lib.Engine, config: low_config.LowConfig) -> _Task:
    """Returns the task of a run, one episode after the other."""
    env = wrappers.AutoReset(locomotion.Locomotion.of_config(engine, config))
    return _Task(jax.jit(env.reset), jax.jit(env.step))
