"""Training of the baselines, of any method: in a maze, or in a task of their authors."""

import dataclasses
import functools
from typing import Any, Protocol, TypeAlias, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from eihrl_jax import base, mazes, robots
from eihrl_jax.agents import devices
from eihrl_jax.baselines import interface
from eihrl_jax.baselines.world import World
from eihrl_jax.config import baselines as config_lib
from eihrl_jax.config import brax as brax_config
from eihrl_jax.config import hess as hess_config
from eihrl_jax.envs import goal_maze, wrappers
from eihrl_jax.mazes import generators
from eihrl_jax.physics import engines
from eihrl_jax.robots import robot as robot_lib
from eihrl_jax.runs import policies
from eihrl_jax.runs import sources as runs_sources
from eihrl_jax.training import loop, parallel, sources
from eihrl_jax.training import metrics as metrics_lib

State: TypeAlias = Any
"""Each baseline has a state and a carry of its own, which nothing looks into here."""


@runtime_checkable
class RobotEnvironment(base.Environment, Protocol):
    """An environment of one robot."""

    @property
    def robot(self) -> robot_lib.Robot:
        """Which robot it is."""
        ...


@dataclasses.dataclass(frozen=True)
class Arena:
    """A maze with a robot, and the baseline that learns in it; compiled once for all its runs.

    Attributes:
      title: what is done where, in a few words.
      env: the maze.
      side_xy: its sides, units.
      baseline: what learns.
      episode_steps: control steps of the longest episode.
      sources: what the options of maze and robot name, see `runs.sources`.
      mesh: devices over which training is sharded; by default one.
    """

    title: str
    env: RobotEnvironment
    side_xy: tuple[int, int]
    baseline: interface.Actor
    episode_steps: int
    sources: runs_sources.Sources = dataclasses.field(default_factory=dict)
    mesh: jax.sharding.Mesh = dataclasses.field(default_factory=lambda: parallel.make_mesh(1))

    @functools.cached_property
    def init(self) -> jax.stages.Wrapped:
        """Makes the state of a run that is about to start, of a key."""
        return jax.jit(
            self.baseline.init, out_shardings=self._shardings, compiler_options=base.QUICK_COMPILE
        )

    @functools.cached_property
    def advance(self) -> jax.stages.Wrapped:
        """Acts and learns: (state, number of rounds) to (state, metrics of each)."""
        baseline = self.baseline
        assert isinstance(baseline, interface.Baseline)
        alike = devices.sharding(self.mesh)

        def advance(state: State, num_rounds: int) -> tuple[State, dict[str, Array]]:
            return jax.lax.scan(lambda state, _: baseline.advance(state), state, length=num_rounds)

        # Donated: a replay is large, and the state before isn't needed any more.
        return jax.jit(
            advance,
            static_argnums=1,
            donate_argnums=0,
            in_shardings=(self._shardings,),
            out_shardings=(self._shardings, alike),
        )

    @functools.cached_property
    def evaluate(self) -> jax.stages.Wrapped:
        """Runs episodes without exploration.

        (policy, key, number of episodes) to sums of the episodes' metrics, and their number.
        """
        return jax.jit(self._evaluate, static_argnums=2)

    @functools.cached_property
    def _shardings(self) -> State:
        """Shardings of a state; a learner from elsewhere shards its own."""
        if isinstance(self.baseline, interface.RowLearner):
            return devices.sharding(self.mesh)
        state = jax.eval_shape(self.baseline.init, jax.random.key(0))
        return devices.shardings(state, self.mesh)

    def _evaluate(
        self, policy: base.Params, key: Key[Array, ""], num_episodes: int
    ) -> dict[str, Float[Array, ""]]:
        env_key, _ = jax.random.split(key)  # Acting draws nothing; splitting keeps the episodes.
        envs = jax.vmap(self.env.reset)(jax.random.split(env_key, num_episodes))
        # Every episode has a carry of its own; they all start alike.
        carries = jax.tree.map(lambda leaf: jnp.stack([leaf] * num_episodes), self.baseline.start())

        def is_running(pair: tuple[base.EnvState, State]) -> Array:
            return ~pair[0].is_over.all()

        def body(pair: tuple[base.EnvState, State]) -> tuple[base.EnvState, State]:
            envs, carries = pair
            ctrl, carries = jax.vmap(self.baseline.act, (None, 0, 0))(policy, carries, envs.obs)
            return jax.vmap(self.env.step)(envs, ctrl), carries

        # Until the last one is over: those that ended earlier rest, so their metrics stay.
        envs, _ = jax.lax.while_loop(is_running, body, (envs, carries))
        sums = {f"sum_{name}": value.sum() for name, value in envs.metrics.items()}
        return sums | {"episodes": jnp.float32(num_episodes)}


def make_arena(config: config_lib.BaselineConfig) -> Arena:
    """Builds maze, robot and baseline.

    Raises:
      base.UserError: the maze or the robot is unknown, or an episode too short.
    """
    robot = robots.load(config.robot)
    engine = engines.make(robot, config.engine)
    maze = mazes.load(config.maze, num_decisions=config.num_decisions)
    env = goal_maze.GoalMaze(engine, maze, reward=config.reward)

    # Evaluated in the maze as it is, whatever helps exploration in training.
    trained_in: base.Environment = env
    if config.goals == "anywhere":
        mazes_in = generators.goals_anywhere(maze)
        trained_in = goal_maze.GoalMaze(engine, mazes_in, reward=config.reward)
    if isinstance(config, config_lib.FlatConfig):
        # The others begin new episodes themselves, between two subgoals.
        trained_in = wrappers.AutoReset(trained_in)

    steps = int(env.table.mazes.num_decisions.max())  # control steps, as `GoalMaze` counts them
    if isinstance(config, hess_config.HessConfig) and config.period >= steps:
        raise base.UserError(
            f"period = {config.period} must be smaller than the {steps} control steps of an episode"
        )
    mesh = _make_mesh(config)
    baseline = interface.make(World(trained_in, engine.model.nu, env.side_xy, steps, mesh), config)
    made_of = {"maze": sources.of_maze(maze), "robot": sources.of_robot(config.robot)}
    title = f"{config.method} in {config.maze}"
    return Arena(title, env, env.side_xy, baseline, steps, made_of, mesh)


def _make_mesh(config: config_lib.BaselineConfig) -> jax.sharding.Mesh:
    """Makes the mesh over which training is sharded.

    Raises:
      base.UserError: there are fewer devices, or they can't share the work evenly.
    """
    num_devices = parallel.or_one_on_cpu(config.num_devices)
    if isinstance(config, brax_config.BraxConfig):  # whose learners take what they are told
        num_devices = config.num_devices or 1
    return parallel.make_mesh(num_devices, **config.shared)


def train(config: config_lib.BaselineConfig, watch: loop.Watch | None = None) -> None:
    """Trains a baseline in a run folder, or resumes a stopped run.

    The run folder ends up with the policy. In a run of several processes all must call this; the
    first one writes.

    Args:
      config: the options of the method.
      watch: draws what is new in the run folder.

    Raises:
      base.UserError: an option or the run folder is not as it should be.
    """
    if config.coordinator is not None and isinstance(config, brax_config.BraxConfig):
        raise base.UserError(
            f"coordinator = {config.coordinator!r} is for runs of several processes: "
            f"method = {config.method!r} trains in one"
        )
    parallel.connect(config.coordinator, config.num_processes, config.process_id)
    train_in(make_arena(config), config, watch)


def train_in(
    arena: Arena, config: config_lib.BaselineConfig, watch: loop.Watch | None = None
) -> None:
    """Trains as `train` does, where and with what `arena` says.

    Raises:
      base.UserError: the run folder is not as it should be.
    """
    try:
        loop.run(_Job(arena, config), config, watch)
    finally:
        if isinstance(arena.baseline, interface.RowLearner):
            arena.baseline.close()


@dataclasses.dataclass(frozen=True)
class _Job(loop.Job[State]):
    """A run of a baseline; counts control steps of all environments together, see `loop.Job`."""

    arena: Arena
    config: config_lib.BaselineConfig

    @property
    def plan(self) -> loop.Plan:
        per_row = self.arena.baseline.steps_per_round * self.config.log_rounds
        return loop.Plan(
            kind="baseline",
            title=self.arena.title,
            num_steps=self.config.num_steps,
            log_every=per_row,
            evaluate_every=per_row * self.config.evaluate_every,
            checkpoint_every=per_row * self.config.checkpoint_every,
            length_option="num_steps",
            may_change=("num_steps", *parallel.OPTIONS),
            shown={"eval/success": "success", "success": "while exploring"},
        )

    @property
    def sources(self) -> runs_sources.Sources:
        return self.arena.sources

    @functools.cached_property
    def _keys(self) -> Key[Array, "2"]:
        """Keys of the first state and of evaluations."""
        return jax.random.split(jax.random.key(self.config.seed))

    def init(self) -> State:
        return self.arena.init(self._keys[0])

    def compile_training(self, state: State) -> loop.Advance[State]:
        """Compiles the rounds of a row."""
        baseline = self.arena.baseline
        if isinstance(baseline, interface.RowLearner):
            # It compiles what it needs by itself, when the first row is asked for.
            num_rows = -(-(self.config.num_steps - int(state.num_steps)) // self.plan.log_every)
            baseline.begin(state, num_rows, self.config.log_rounds)
            return baseline.next_row

        # Shapes alone: a state that was restored is the same program's as a new one.
        shapes = jax.eval_shape(lambda: state)
        return self.arena.advance.lower(shapes, self.config.log_rounds).compile()

    def compile_evaluation(self, state: State) -> loop.Evaluate[State]:
        """Compiles episodes without exploration."""
        baseline, per_row = self.arena.baseline, self.plan.log_every
        shapes = jax.eval_shape(lambda: (baseline.policy(state), jax.random.key(0)))
        measure = self.arena.evaluate.lower(*shapes, self.config.num_eval_episodes).compile()

        def evaluate(state: State, done: int) -> dict[str, float]:
            # By row, not by a counter: a run that goes on draws the same episodes.
            key = jax.random.fold_in(self._keys[1], done // per_row)
            means = metrics_lib.summarise(measure(parallel.local(baseline.policy(state)), key))
            means["reward"] = means["return"] / means["steps"]
            return {f"eval/{name}": value for name, value in means.items()}

        return evaluate

    def row(self, state: State, metrics: loop.Metrics) -> dict[str, float]:
        """Returns means over the episodes that ended, and over the rounds."""
        # Per environment, as the time limit counts.
        end = int(state.num_steps) / self.config.num_envs
        begin = end - self.plan.log_every / self.config.num_envs
        is_fair = metrics_lib.is_fair(begin, end, self.arena.episode_steps)
        row = metrics_lib.summarise(metrics, is_fair=is_fair)
        return row | {"episodes": float(metrics["episodes"].sum())}  # that ended since the last row

    def policy(self, state: State) -> tuple[base.Params, policies.Meta]:
        """Returns the parameters, and the JSON values from which the policy can be rebuilt."""
        meta = {
            "method": self.config.method,
            "maze": self.config.maze,
            "robot": self.arena.env.robot.name,
            "side_xy": self.arena.side_xy,
            "config": dataclasses.asdict(self.config),
            "num_steps": int(state.num_steps),
        }
        return self.arena.baseline.policy(state), meta
