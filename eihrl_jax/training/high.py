"""Training of the high level: PEG-A2C in a maze with oracle movement (paper, Sec. 3.2 and 4.1)."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from eihrl_jax import base, mazes, robots
from eihrl_jax.agents import peg_a2c
from eihrl_jax.agents.peg_a2c import LearnerState
from eihrl_jax.config import checks
from eihrl_jax.config import high as high_config
from eihrl_jax.envs import oracle_maze, raster, subgoals, wrappers
from eihrl_jax.mazes import generators
from eihrl_jax.networks import actor_critic
from eihrl_jax.runs import folders, policies
from eihrl_jax.runs import sources as runs_sources
from eihrl_jax.training import loop, parallel, sources
from eihrl_jax.training import metrics as metrics_lib

_EVALUATION_STREAM = 1
"""Folded into the seed's key for evaluation, so that its draws differ from training's."""


def train(
    config: high_config.HighConfig,
    with_physics: base.Environment | None = None,
    watch: loop.Watch | None = None,
) -> float:
    """Trains a high level in a run folder, or resumes a stopped run.

    The run folder ends up with the policy. In a run of several processes all must call this; the
    first one writes.

    Args:
      config: the run's options.
      with_physics: the environment of `in_use` with physics, in which the policy is also evaluated;
        its metrics have the prefix `walking/` instead of `eval/`.
      watch: updates pictures in the run folder.

    Returns:
      Seconds of training, with evaluations and checkpoints but without compilation.

    Raises:
      base.UserError: options don't fit together, or see `loop.run`.
    """
    folders.check_free(config.run, resume=config.resume)  # before anything slow
    parallel.connect(config.coordinator, config.num_processes, config.process_id)
    env = make_env(config.task, config.seed)
    agent = make_agent(env, config)
    mesh = parallel.make_mesh(config.num_devices, num_workers=config.learner.num_workers)
    evaluated_in: dict[str, base.Environment] = {"eval": in_use(env, config)}
    if with_physics is not None:
        evaluated_in["walking"] = with_physics
    return loop.run(_Job(config, env, agent, mesh, evaluated_in), config, watch)


@dataclasses.dataclass(frozen=True)
class _Job(loop.Job[LearnerState]):
    """A run of the high level; counts updates, see `loop.Job`.

    Attributes:
      config: its options.
      env: the maze, without reset.
      agent: the learner.
      mesh: devices over which its workers are spread.
      evaluated_in: where it is evaluated, by the prefix of the metrics.
    """

    config: high_config.HighConfig
    env: oracle_maze.OracleMaze
    agent: peg_a2c.PegA2C
    mesh: jax.sharding.Mesh
    evaluated_in: Mapping[str, base.Environment]

    @property
    def plan(self) -> loop.Plan:
        return loop.Plan(
            kind="high",
            title=f"{_title(self.config.task)} high level",
            num_steps=self.config.learner.num_updates,
            log_every=self.config.log_every,
            evaluate_every=self.config.evaluate_every,
            checkpoint_every=self.config.checkpoint_every,
            length_option="num_updates",
            # Not its length: the schedules of learning rate and entropy depend on it.
            may_change=parallel.OPTIONS,
            shown={"success": "success", "entropy": "entropy"},
            unit="decisions",
            units_per_step=decisions_per_update(self.agent),
        )

    @property
    def sources(self) -> runs_sources.Sources:
        task = self.config.task
        return {
            "task.maze": {} if task.num_rooms else sources.of_maze(self.env.table.mazes),
            "task.robot": sources.of_robot(task.robot),
            "task.measured": sources.of_measurement(task.measured),
        }

    def init(self) -> LearnerState:
        return parallel.init(self.agent, self.config.seed, self.mesh)

    def compile_training(self, state: LearnerState) -> loop.Advance[LearnerState]:
        """Compiles `log_every` updates."""
        update = parallel.repeated_update(self.agent, self.config.log_every, self.mesh)
        return update.lower(state).compile()

    def compile_evaluation(self, state: LearnerState) -> loop.Evaluate[LearnerState]:
        """Compiles whole episodes in each environment, subgoals chosen as in use."""
        measures = {
            prefix: self._compile_measure(env, state) for prefix, env in self.evaluated_in.items()
        }

        def evaluate(state: LearnerState, done: int) -> dict[str, float]:
            row = {}
            # Parameters are evaluated; `num_updates` only makes the draws of each row different.
            for prefix, measure in measures.items():
                means = summarise(measure(*parallel.local((state.params, state.num_updates))))
                means["reward"] = means["return"] / means["decisions"]
                row |= {f"{prefix}/{name}": value for name, value in means.items()}
            return row

        return evaluate

    def _compile_measure(
        self, env: base.Environment, state: LearnerState
    ) -> Callable[..., loop.Metrics]:
        """Compiles sums over episodes, each of up to the limit of decisions of the longest one."""
        config = self.config
        # Whole episodes, also where training cuts them into windows.
        whole = dataclasses.replace(config.learner, window=None)
        limit = int(self.env.table.mazes.num_decisions.max())
        network = actor_critic.in_use(actor_critic.make(config.network))
        agent = peg_a2c.PegA2C(env, network, whole, limit)
        stream = jax.random.fold_in(jax.random.key(config.seed), _EVALUATION_STREAM)

        def measure(params, num_updates):
            # Derived from the update, so that a resumed run draws the same episodes.
            keys = jax.random.split(
                jax.random.fold_in(stream, num_updates), config.num_eval_episodes
            )
            collect = functools.partial(agent.collect_episode, greedy=config.greedy)
            _, _, counts = jax.vmap(collect, (None, 0))(params, keys)
            return jax.tree.map(jnp.sum, counts)

        return jax.jit(measure).lower(*parallel.local((state.params, state.num_updates))).compile()

    def row(self, state: LearnerState, metrics: loop.Metrics) -> dict[str, float]:
        """Returns means over the episodes that ended, and over the updates."""
        # Without a window every episode that began has ended: so the means are unbiased.
        window, is_fair = self.config.learner.window, True
        if window is not None:
            end = int(state.num_updates) * window
            limit = int(self.env.table.mazes.num_decisions.max())
            is_fair = metrics_lib.is_fair(end - self.config.log_every * window, end, limit)

        row = {"num_decisions": float(state.num_decisions)} | summarise(metrics, is_fair=is_fair)
        return row | {"episodes": float(metrics["episodes"].sum())}  # that ended since the last row

    def policy(self, state: LearnerState) -> tuple[base.Params, policies.Meta]:
        """Returns the parameters, and the JSON values from which the policy can be rebuilt."""
        task = self.config.task
        meta = {
            "maze": _title(task),
            "robot": robots.load(task.robot).name,
            "view": dataclasses.asdict(self.env.view),
            "network": dataclasses.asdict(self.config.network),
            "greedy": self.config.greedy,
            "movement": {
                "step": self.env.movement.step,
                "sigma": self.env.movement.sigma,
                "anchored": self.env.movement.anchored,
            },
            "config": dataclasses.asdict(task) | dataclasses.asdict(self.config.learner),
            "num_updates": int(state.num_updates),
            "num_decisions": int(state.num_decisions),
        }
        return state.params, meta


def make_env(task: high_config.Task, seed: int = 0) -> oracle_maze.OracleMaze:
    """Builds the maze with oracle movement; it doesn't reset itself.

    Args:
      task: maze, movement and view.
      seed: of random rooms, if the task has some.

    Raises:
      base.UserError: the maze or the robot is unknown, or numbers don't fit together.
    """
    robot = robots.load(task.robot)
    view = raster.View(
        extent=task.extent, pixels=task.pixels, map_radius=task.map_radius, knows=task.knows
    )
    gait = subgoals.gait(robot, task.measured, task.step, task.sigma)
    shown = gait.bank.replace(qpos=gait.bank.qpos[: task.num_postures])

    return oracle_maze.OracleMaze.of_robot(
        robot,
        _mazes(task, seed),
        view=view,
        gait=gait._replace(bank=shown),
        num_substeps=task.num_substeps,
        anchored=task.anchored,
        reward=task.reward,
    )


def in_use(env: oracle_maze.OracleMaze, config: high_config.HighConfig) -> oracle_maze.OracleMaze:
    """Returns the environment as in use after training: with a map of the whole maze, if any.

    Args:
      env: the maze of `make_env`.
      config: the run's options.
    """
    network = actor_critic.make(config.network)
    return env.covering() if actor_critic.takes_any_map(network) else env


def make_agent(env: oracle_maze.OracleMaze, config: high_config.HighConfig) -> peg_a2c.PegA2C:
    """Builds the learner of a maze.

    Raises:
      base.UserError: the window is longer than an episode, or there are more than 2^31 - 1
        decisions.
    """
    limits = env.table.mazes.num_decisions
    window = config.learner.window
    trained_in: base.Environment = env
    if window is not None:
        # A longer window could be cut by the time limit twice.
        checks.in_range("window", window, 1, int(limits.min()))
        trained_in = wrappers.AutoReset(env, env.observe)

    network, learner = actor_critic.make(config.network), config.learner
    if config.task.reward == "dense":
        # The return until the limit depends on the time left, which isn't observed: bootstrapping
        # at the limit removes that noise from the value's targets.
        learner = dataclasses.replace(learner, looks_beyond_limit=True)

    agent = peg_a2c.PegA2C(trained_in, network, learner, window or int(limits.max()))
    most = (2**31 - 1) // decisions_per_update(agent)  # Decisions are counted in 32 bits.
    checks.in_range("num_updates", config.learner.num_updates, 1, most)
    return agent


def decisions_per_update(agent: peg_a2c.PegA2C) -> int:
    """Returns the decisions per update, with whole episodes the most there can be."""
    return agent.horizon * agent.learner.num_workers


def summarise(metrics: Mapping[str, Any], *, is_fair: bool = True) -> dict[str, float]:
    """Turns the metrics of some updates, see `PegA2C.update`, into numbers.

    Returns:
      Means over the episodes that ended, NaN where none did or where they aren't `is_fair`, and
      means over the updates.
    """
    counted = {name: values for name, values in metrics.items() if name != "decisions"}
    return metrics_lib.summarise(counted, is_fair=is_fair)


def _mazes(task: high_config.Task, seed: int) -> mazes.Maze:
    """Loads the maze of a task, or draws its random rooms."""
    if not task.num_rooms:
        return mazes.load(task.maze, num_decisions=task.num_decisions)

    rooms = generators.training_rooms(
        seed,
        task.num_rooms,
        sides=task.room_sides,
        wall_share=task.room_walls,
        num_decisions=task.num_decisions,
    )
    return mazes.stack(rooms)


def _title(task: high_config.Task) -> str:
    """Returns the title of the progress bar."""
    return f"{task.num_rooms} random rooms" if task.num_rooms else task.maze
