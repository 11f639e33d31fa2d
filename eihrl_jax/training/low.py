"""Training the low level: walk, store, learn, measure, checkpoint (paper, Sec. 3.2)."""

import functools
import pathlib
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base, robots
from eihrl_jax.agents import droq, replay
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import experience, locomotion, low_obs, postures, rooms, subgoals, wrappers
from eihrl_jax.ops import tree
from eihrl_jax.physics import engines
from eihrl_jax.runs import checkpoint, policies, run_folder, versions
from eihrl_jax.runs import progress as progress_lib


class LowState(struct.PyTreeNode):
    """All that a run needs to go on. N: number of environments.

    Attributes:
      learner: networks and optimisers.
      memory: stored steps.
      envs: environments with leading axis N.
      key: of what comes next.
      iteration: int32, vector steps done.
    """

    learner: droq.DroqState
    memory: replay.Replay
    envs: base.EnvState
    key: Key[Array, ""]
    iteration: Int[Array, ""]


class LowTrainer:
    """The functions of one run; holds no state that changes."""

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
        floor = (
            rooms.random_rooms(config.num_rooms, config.seed)
            if config.num_rooms
            else rooms.open_floor()
        )
        make_env = functools.partial(
            locomotion.Locomotion,
            engine,
            reward_options=config.reward,
            episode_steps=config.episode_steps,
            ends_at_fall=config.ends_at_fall,
        )
        self._env = wrappers.AutoReset(make_env(floor))
        self._test_env = wrappers.AutoReset(make_env(rooms.open_floor()))
        obs = jax.eval_shape(self._env.reset, jax.random.key(0)).obs
        self.num_features = jax.eval_shape(self._features, obs).shape[0]
        self._learner = droq.Droq(self.num_features, self._num_actions, config.droq)
        # Each is compiled once for all runs that the trainer is used for.
        self.jit_init = jax.jit(self.init)
        self.jit_warm_up = jax.jit(self.warm_up, donate_argnums=0)
        self.jit_advance = jax.jit(self.advance, donate_argnums=0)
        self.jit_measure = jax.jit(self.measure, static_argnums=(2, 3))
        self.jit_record_postures = jax.jit(self.record_postures)

    def init(self, key: Key[Array, ""]) -> LowState:
        """Returns the state of a run that is about to start, its memory still empty."""
        key, learner_key, env_key = jax.random.split(key, 3)
        envs = jax.vmap(self._env.reset)(jax.random.split(env_key, self.config.num_envs))
        ctrl = jnp.zeros((self.config.num_envs, self._num_actions))
        example = jax.eval_shape(self._walk, envs, ctrl)[1]
        return LowState(
            learner=self._learner.init(learner_key),
            memory=replay.init(replay.row(example), self.config.capacity),
            envs=envs,
            key=key,
            iteration=jnp.int32(0),
        )

    def warm_up(self, state: LowState) -> LowState:
        """Fills the memory with steps of random controls."""

        def body(state: LowState, _: None) -> tuple[LowState, None]:
            key, ctrl_key = jax.random.split(state.key)
            shape = (self.config.num_envs, self._num_actions)
            ctrl = jax.random.uniform(ctrl_key, shape, minval=-1.0, maxval=1.0)
            envs, stored = self._walk(state.envs, ctrl)
            memory = replay.add(state.memory, stored)
            return state.replace(envs=envs, memory=memory, key=key), None

        return jax.lax.scan(body, state, length=self.config.warmup_iterations)[0]

    def advance(self, state: LowState) -> tuple[LowState, dict[str, Float[Array, ""]]]:
        """Runs `log_every` iterations: each walks one step in every environment, then learns.

        Returns:
          The new state, and the means of the learner's and the environments' metrics.
        """
        state, (learned, walked) = jax.lax.scan(self._iterate, state, length=self.config.log_every)
        metrics = {f"learner/{name}": jnp.nanmean(value) for name, value in learned.items()}
        return state, metrics | subgoals.summarise(walked)

    def sample(
        self, actor_params: base.Params, obs: low_obs.LowObs, key: Key[Array, ""]
    ) -> Float[Array, " nu"]:
        """Draws the controls of one robot."""
        action = self._learner.sample(actor_params, self._features(obs), key)
        return low_obs.ctrl_from_action(action, obs, self.robot, self.config.low_input)

    def mode(self, actor_params: base.Params, obs: low_obs.LowObs) -> Float[Array, " nu"]:
        """Returns the controls of one robot without exploration."""
        action = self._learner.mode(actor_params, self._features(obs))
        return low_obs.ctrl_from_action(action, obs, self.robot, self.config.low_input)

    def measure(
        self, actor_params: Any, key: Key[Array, ""], num_envs: int = 64, num_subgoals: int = 12
    ) -> dict[str, Float[Array, ""]]:
        """Returns the subgoal statistics of the deterministic policy on open floor."""
        _, walked, _ = self._roll(actor_params, key, num_envs, num_subgoals)
        return subgoals.summarise(walked)

    def record_postures(self, actor_params: Any, key: Key[Array, ""]) -> Float[Array, "K nq"]:
        """Records `num_postures` postures of the walking robot, x and y zeroed.

        They come from deterministic walking with random subgoals, the first subgoal left out, and
        are spread evenly over environments and time (paper, Sec. 3.2).
        """
        num_envs, num_subgoals = 64, 12
        qpos, _, _ = self._roll(actor_params, key, num_envs, num_subgoals)
        qpos = qpos[self.robot.steps_per_subgoal :].reshape(-1, qpos.shape[-1])
        count = self.config.num_postures
        index = jnp.linspace(0, qpos.shape[0] - 1, count).astype(jnp.int32)
        return qpos[index].at[:, :2].set(0.0)

    def meta(self) -> dict[str, Any]:
        """Returns what must stand beside the parameters for them to be used."""
        return {
            "robot": self.robot.name,
            "low_input": vars(self.config.low_input),
            "hidden": list(self.config.droq.hidden),
            "num_features": self.num_features,
            "num_actions": self._num_actions,
        }

    def _features(self, obs: low_obs.LowObs) -> Float[Array, " F"]:
        return low_obs.features(obs, self.robot, self.config.low_input)

    def _iterate(self, state: LowState, _: None) -> tuple[LowState, tuple[dict, dict]]:
        """Walks one step in every environment, then updates the learner."""
        key, act_key, learn_key = jax.random.split(state.key, 3)
        act_keys = jax.random.split(act_key, self.config.num_envs)
        ctrl = jax.vmap(self.sample, (None, 0, 0))(
            state.learner.actor_params, state.envs.obs, act_keys
        )
        envs, stored = self._walk(state.envs, ctrl)
        memory = replay.add(state.memory, stored)

        # Drawn at once, outside the loop over updates: XLA would copy the memory into that loop.
        count = self.config.updates_per_iteration
        batch_key, update_key = jax.random.split(learn_key)
        batches = self._draw(memory, count, batch_key)
        learner, learned = jax.lax.scan(
            lambda learner, batch: self._learner.update(learner, *batch),
            state.learner,
            (batches, jax.random.split(update_key, count)),
        )
        state = LowState(
            learner=learner, memory=memory, envs=envs, key=key, iteration=state.iteration + 1
        )
        return state, (learned, envs.metrics)

    def _walk(
        self, envs: base.EnvState, ctrl: Float[Array, "N nu"]
    ) -> tuple[base.EnvState, experience.Experience]:
        """Steps every environment, and returns what is to be stored of it."""
        stepped = jax.vmap(self._env.step)(envs, ctrl)
        return stepped, jax.vmap(experience.of_step)(envs, ctrl, stepped)

    def _draw(
        self, memory: replay.Replay, num_batches: int, key: Key[Array, ""]
    ) -> base.Transition:
        """Draws batches with leading axes [num_batches, B], relabelled if the run says so."""
        row_key, direction_key, share_key = jax.random.split(key, 3)
        shape = (num_batches, self.config.droq.batch_size)
        rows = replay.sample(memory, shape, row_key)
        if self.config.relabel != "never":
            direction = jax.random.randint(direction_key, shape, 0, base.NUM_DIRECTIONS)
            is_seen_anew = jax.random.bernoulli(share_key, self.config.relabel_share, shape)
            rows = jax.vmap(jax.vmap(self._see_anew))(rows, direction, is_seen_anew)
        transition = functools.partial(
            experience.transition,
            robot=self.robot,
            input_options=self.config.low_input,
            reward_options=self.config.reward,
            gamma=self.config.droq.gamma,
        )
        return jax.vmap(jax.vmap(transition))(rows)

    def _see_anew(
        self, row: experience.Experience, direction: Int[Array, ""], is_seen_anew: Bool[Array, ""]
    ) -> experience.Experience:
        """Returns a stored step, or what it would be if `direction` had been asked for."""
        if self.config.relabel == "direction":
            anew = experience.relabel(row, direction)
        else:
            anew = experience.restart(row, direction, self.robot)
        return tree.where(is_seen_anew, anew, row)

    def _roll(
        self, actor_params: Any, key: Key[Array, ""], num_envs: int, num_subgoals: int
    ) -> tuple[Float[Array, "T N nq"], dict[str, Float[Array, "T N"]], base.EnvState]:
        """Walks deterministically on open floor; returns qpos and metrics of every step."""
        env_key, _ = jax.random.split(key)  # The second half is free; splitting keeps the draws.
        envs = jax.vmap(self._test_env.reset)(jax.random.split(env_key, num_envs))

        def body(envs: base.EnvState, _: None) -> tuple[base.EnvState, tuple[Array, dict]]:
            ctrl = jax.vmap(self.mode, (None, 0))(actor_params, envs.obs)
            envs = jax.vmap(self._test_env.step)(envs, ctrl)
            return envs, (envs.inner.physics.qpos, envs.metrics)

        length = num_subgoals * self.robot.steps_per_subgoal
        envs, (qpos, walked) = jax.lax.scan(body, envs, length=length)
        return qpos, walked, envs


def train(config: low_config.LowConfig) -> None:
    """Trains a low level in a run folder, or goes on with a run that was stopped.

    The run folder ends up with the policy, its subgoal statistics and the posture bank.

    Args:
      config: the run's options.

    Raises:
      base.UserError: an option or the run folder is not as it should be.
    """
    train_with(LowTrainer(config), config)


def train_with(trainer: LowTrainer, config: low_config.LowConfig) -> None:
    """Does what `train` does, with a trainer that may have been compiled for another run.

    Args:
      trainer: made of options that differ at most in the run's folder, length and start.
      config: the run's options.

    Raises:
      base.UserError: the run folder is not as it should be.
    """
    if checkpoint.last_step(config.run / run_folder.CHECKPOINTS) is None:
        _check_start(config)
    with run_folder.RunFolder.create(
        config.run, config, resume=config.resume, may_change={"num_iterations"}
    ) as run:
        init_key, measure_key, posture_key = jax.random.split(jax.random.key(config.seed), 3)
        state = trainer.jit_init(init_key)
        restored = run.restore(state)
        done, state = (0, state) if restored is None else restored
        if restored is None and config.start_from is not None:
            state = _start_from(config.start_from, state)
        title = f"{config.robot} low level"
        with progress_lib.Progress(
            title, config.num_iterations * config.num_envs, done=done * config.num_envs
        ) as progress:
            advance, measure = _compile(trainer, state, progress)
            if restored is None and config.start_from is None:
                progress.print(f"{title}: filling the memory with random steps ...")
                state = trainer.jit_warm_up(state)

            def evaluate() -> dict[str, Float[Array, ""]]:
                key = jax.random.fold_in(measure_key, done)
                return measure(state.learner.average_params, key)

            measured: dict[str, Array] = {}
            while done < config.num_iterations:
                state, metrics = advance(state)
                done += config.log_every
                is_last = done >= config.num_iterations
                if done % config.evaluate_every == 0 or is_last:
                    measured = {f"eval/{name}": value for name, value in evaluate().items()}
                    metrics |= measured
                run.log(done, {name: float(value) for name, value in metrics.items()})
                shown = _shown({name: float(value) for name, value in (metrics | measured).items()})
                progress.update(done * config.num_envs, shown)
                if done % config.checkpoint_every == 0 or is_last:
                    run.save(done, state)
        _finish(trainer, run, state, measure_key, posture_key)


def _check_start(config: low_config.LowConfig) -> None:
    """Makes sure that the run with which this one begins, if any, has a state to begin with."""
    start = config.start_from
    if start is not None and checkpoint.last_step(start / run_folder.CHECKPOINTS) is None:
        raise base.UserError(f"start_from = {start} holds no checkpoint")


def _start_from(path: pathlib.Path, fresh: LowState) -> LowState:
    """Returns learner and memory of another run's last state, all else being this one's.

    Raises:
      base.UserError: its checkpoint is damaged, or of another structure.
    """
    found = checkpoint.restore(path / run_folder.CHECKPOINTS, fresh)
    assert found is not None  # `train` has looked
    return fresh.replace(learner=found[1].learner, memory=found[1].memory)


def _compile(
    trainer: LowTrainer, state: LowState, progress: progress_lib.Progress
) -> tuple[Callable, Callable]:
    """Compiles training and measurement ahead, so that the time it takes can be told."""
    # Shapes alone: a state that was restored is the same program's as a new one.
    shapes = jax.eval_shape(lambda: state)
    with progress.compiling("training"):
        advance = trainer.jit_advance.lower(shapes).compile()
    with progress.compiling("measurement"):
        args = shapes.learner.average_params, shapes.key
        measure = trainer.jit_measure.lower(*args).compile()
    return advance, measure


def _finish(
    trainer: LowTrainer,
    run: run_folder.RunFolder,
    state: LowState,
    measure_key: Key[Array, ""],
    posture_key: Key[Array, ""],
) -> None:
    """Writes policy, statistics and posture bank of a run that has reached its end."""
    params = state.learner.average_params
    measured = trainer.jit_measure(params, measure_key, 256, 20)
    measured = {name: float(value) for name, value in measured.items()}
    record = {
        "statistics": measured,
        "num_iterations": int(state.iteration),
        "num_updates": int(state.learner.num_updates),
        "versions": versions.describe(),
    }
    policies.save(
        run.path / policies.FOLDER,
        kind="low",
        params=params,
        meta=trainer.meta() | record,
        overwrite=True,
    )
    qpos = trainer.jit_record_postures(params, posture_key)
    bank = postures.PostureBank(qpos=qpos)
    postures.save(bank, run.path / "postures.npz", trainer.robot)


def _shown(metrics: dict[str, float]) -> dict[str, float]:
    """Picks what the progress bar shows."""
    names = {"eval/along_mean": "along", "eval/lateral_std": "sideways std", "falls": "falls/1000"}
    return {short: metrics[name] for name, short in names.items() if name in metrics}
