"""Training of the low level (paper, Sec. 3.2): the run; `low_trainer` has what is computed."""

import dataclasses
import functools
import pathlib

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from eihrl_jax import base
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import postures, subgoals
from eihrl_jax.runs import checkpoint, policies, run_folder
from eihrl_jax.runs import progress as progress_lib
from eihrl_jax.runs import sources as runs_sources
from eihrl_jax.training import loop, parallel, sources
from eihrl_jax.training.low_trainer import LowState, LowTrainer

_NUM_PIECES = 20
"""Pieces in which the replay is filled, so that one sees how far that is."""


@dataclasses.dataclass(frozen=True)
class _Job(loop.Job[LowState]):
    """A run of the low level; counts iterations, see `loop.Job`.

    Attributes:
      trainer: its compiled functions.
      config: its options.
      start: last state of the run with whose learner and replay this one begins, if any.
    """

    trainer: LowTrainer
    config: low_config.LowConfig
    start: LowState | None

    @property
    def plan(self) -> loop.Plan:
        return loop.Plan(
            kind="low",
            title=f"{self.config.robot} low level",
            num_steps=self.config.num_iterations,
            log_every=self.config.log_every,
            evaluate_every=self.config.evaluate_every,
            checkpoint_every=self.config.checkpoint_every,
            length_option="num_iterations",
            may_change=("num_iterations", *parallel.OPTIONS),
            shown={
                "eval/along_mean": "along",
                "eval/lateral_std": "sideways std",
                "falls": "falls/1000",
            },
            units_per_step=self.config.num_envs,  # an iteration steps every robot once
        )

    @property
    def sources(self) -> runs_sources.Sources:
        return {"robot": sources.of_robot(self.config.robot)}

    @functools.cached_property
    def _keys(self) -> Key[Array, "3"]:
        """Keys of the first state, of evaluations and of the recorded postures."""
        return jax.random.split(jax.random.key(self.config.seed), 3)

    def init(self) -> LowState:
        return self.trainer.jit_init(self._keys[0])

    def compile_training(self, state: LowState) -> loop.Advance[LowState]:
        """Compiles `log_every` iterations."""
        # Shapes alone: a state that was restored is the same program's as a new one.
        return self.trainer.jit_advance.lower(jax.eval_shape(lambda: state)).compile()

    def compile_evaluation(self, state: LowState) -> loop.Evaluate[LowState]:
        """Compiles the measurement of subgoals."""
        shapes = jax.eval_shape(lambda: (state.learner.average_params, state.key))
        measure = self.trainer.jit_measure.lower(*shapes).compile()

        def evaluate(state: LowState, done: int) -> dict[str, float]:
            # By iteration, not by a counter: a run that goes on draws the same subgoals.
            key = jax.random.fold_in(self._keys[1], done)
            params = parallel.local(state.learner.average_params)
            return _numbers(measure(params, key), "eval/")

        return evaluate

    def begin(self, state: LowState, progress: progress_lib.Progress) -> LowState:
        """Takes over what another run has learned and stored, or stores random steps."""
        if self.start is not None:
            # Not its robots nor its iterations: those are the new run's own.
            return self.trainer.place(
                state.replace(learner=self.start.learner, replay=self.start.replay)
            )
        return self._filled(state)

    def _filled(self, state: LowState) -> LowState:
        """Stores random steps, piece by piece."""
        num, done = self.config.warmup_iterations, 0
        title = f"{self.plan.title}: filling the replay with random steps"
        num_envs = self.config.num_envs
        with progress_lib.Progress(title, num * num_envs) as bar:
            # A piece is compiled once; the rest of a division is a program of its own.
            piece = max(1, num // _NUM_PIECES)
            while done < num:
                length = piece if num - done >= piece else num - done
                state = jax.block_until_ready(self.trainer.jit_warm_up(state, length))
                done += length
                bar.update(done * num_envs)
        return state

    def row(self, state: LowState, metrics: loop.Metrics) -> dict[str, float]:
        return _numbers(metrics)

    def policy(self, state: LowState) -> tuple[base.Params, policies.Meta]:
        """Returns the actor's average, and the JSON values from which the policy can be rebuilt."""
        meta = {
            **self.trainer.meta(),
            "num_iterations": int(state.iteration),
            "num_updates": int(state.learner.num_updates),
        }
        return state.learner.average_params, meta

    def finish(self, path: pathlib.Path, state: LowState) -> policies.Meta:
        """Records the posture bank, and measures the policy once more, longer."""
        params = parallel.local(state.learner.average_params)
        _, measure_key, posture_key = self._keys
        walk = functools.partial(self.trainer.roll, params)
        with progress_lib.Progress(f"{self.plan.title}: recording", 12, unit="subgoals") as bar:
            qpos, _ = walk(posture_key, 64, 12, bar)
        bank = postures.PostureBank(qpos=jnp.asarray(self.trainer.postures(qpos)))
        if jax.process_index() == 0:
            postures.save(bank, path / "postures.npz", self.trainer.robot)

        with progress_lib.Progress(f"{self.plan.title}: measuring", 20, unit="subgoals") as bar:
            _, metrics = walk(measure_key, 256, 20, bar)
        return {"statistics": _numbers(jax.jit(subgoals.summarise)(metrics))}


def train(config: low_config.LowConfig, watch: loop.Watch | None = None) -> None:
    """Trains a low level in a run folder, or resumes a stopped run.

    The run folder ends up with the policy, its subgoal statistics and the posture bank. In a run of
    several processes all must call this; the first one writes.

    Args:
      config: the run's options.
      watch: draws what is new in the run folder.

    Raises:
      base.UserError: an option or the run folder is not as it should be.
    """
    parallel.connect(config.coordinator, config.num_processes, config.process_id)
    train_with(LowTrainer(config), config, watch)


def train_with(
    trainer: LowTrainer, config: low_config.LowConfig, watch: loop.Watch | None = None
) -> None:
    """Trains as `train` does, with a trainer that may have been compiled for another run.

    Args:
      trainer: made of options that differ at most in the run's folder, length and start.
      config: the run's options.
      watch: draws what is new in the run folder.

    Raises:
      base.UserError: the run folder is not as it should be.
    """
    start, checkpoints = None, config.run / run_folder.CHECKPOINTS
    # Once it is begun, the run goes on without the other.
    if config.start_from is not None and checkpoint.last_step(checkpoints) is None:
        start = _load_start(trainer, config.start_from)
    loop.run(_Job(trainer, config, start), config, watch)


def _load_start(trainer: LowTrainer, path: pathlib.Path) -> LowState:
    """Loads the last state of the run that another one begins with.

    Raises:
      base.UserError: there is no checkpoint, or one that is damaged, of another structure, or of a
        robot that was another one then.
    """
    # Shapes are enough to read by; no robot is reset for it.
    restored = checkpoint.restore(path / run_folder.CHECKPOINTS, trainer.shapes)
    if restored is None:
        raise base.UserError(f"start_from = {path} holds no checkpoint")

    # What it has stored is another robot's, though it has the same shapes.
    meta = policies.read_meta(policies.find(path, "low"))
    if meta.get("fingerprint") != trainer.fingerprint:
        raise base.UserError(
            f"start_from = {path} is a run of another version of robot {trainer.robot.name!r}: its "
            "model, its times or its range of controls have changed since"
        )
    return restored[1]


def _numbers(metrics: loop.Metrics, prefix: str = "") -> dict[str, float]:
    return {f"{prefix}{name}": float(value) for name, value in metrics.items()}
