"""Training of the baselines: walk, learn, evaluate, checkpoint, whatever the method."""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from eihrl_jax import base, mazes, robots
from eihrl_jax.baselines import interface
from eihrl_jax.config import baselines as config_lib
from eihrl_jax.config import hess as hess_config
from eihrl_jax.envs import goal_maze, wrappers
from eihrl_jax.mazes import generators
from eihrl_jax.physics import engines
from eihrl_jax.runs import checkpoint, policies, run_folder, versions
from eihrl_jax.runs import progress as progress_lib
from eihrl_jax.training import metrics as metrics_lib


@dataclasses.dataclass(frozen=True)
class Arena:
    """A maze with a robot, and the baseline that learns in it; compiled once for all its runs.

    Attributes:
      title: what is done where, in a few words.
      env: the maze.
      side_xy: its sides, units.
      baseline: what learns.
    """

    title: str
    env: Any
    side_xy: tuple[int, int]
    baseline: interface.Baseline

    @functools.cached_property
    def advance(self) -> jax.stages.Wrapped:
        """Walks and learns: (state, number of rounds) to (state, metrics of each)."""

        def advance(state: Any, num_rounds: int) -> tuple[Any, dict[str, Array]]:
            return jax.lax.scan(
                lambda state, _: self.baseline.advance(state), state, length=num_rounds
            )

        return jax.jit(advance, static_argnums=1, donate_argnums=0)

    @functools.cached_property
    def evaluate(self) -> jax.stages.Wrapped:
        """Does what `measure` does: (policy, key, number of episodes) to sums of metrics."""
        return jax.jit(functools.partial(measure, self), static_argnums=2)


def make_arena(config: config_lib.BaselineConfig) -> Arena:
    """Builds maze, robot and baseline.

    Raises:
      base.UserError: the maze or the robot is unknown, or an episode too short.
    """
    robot = robots.load(config.robot)
    engine = engines.make(robot, config.engine)
    maze = mazes.load(config.maze, num_decisions=config.num_decisions)
    env = goal_maze.GoalMaze(engine, maze, reward=config.reward)
    trained_in: base.Environment = env
    if config.goals == "anywhere":
        mazes_in = generators.goals_anywhere(maze)
        trained_in = goal_maze.GoalMaze(engine, mazes_in, reward=config.reward)
    if isinstance(config, config_lib.FlatConfig):
        trained_in = wrappers.AutoReset(trained_in)
    steps = int(env.table.mazes.num_decisions.max())
    if isinstance(config, hess_config.HessConfig) and config.period >= steps:
        raise base.UserError(
            f"period = {config.period} must be smaller than the {steps} control steps of an episode"
        )
    baseline = interface.make(trained_in, engine.model.nu, env.side_xy, steps, config)
    return Arena(f"{config.method} in {config.maze}", env, env.side_xy, baseline)


def train(config: config_lib.BaselineConfig) -> None:
    """Trains a baseline in a run folder, or goes on with a run that was stopped.

    The run folder ends up with the policy.

    Args:
      config: the options of the method.

    Raises:
      base.UserError: an option or the run folder is not as it should be.
    """
    train_in(make_arena(config), config)


def train_in(arena: Arena, config: config_lib.BaselineConfig) -> None:
    """Does what `train` does, where and with what `arena` says.

    Raises:
      base.UserError: the run folder is not as it should be.
    """
    baseline, per_row = arena.baseline, arena.baseline.steps_per_round * config.log_rounds
    walked = checkpoint.last_step(config.run / run_folder.CHECKPOINTS) or 0
    if config.resume and walked - per_row >= config.num_steps:
        raise base.UserError(
            f"num_steps = {config.num_steps} is less than {config.run} has walked: {walked}"
        )
    with run_folder.RunFolder.create(
        config.run, config, resume=config.resume, may_change={"num_steps"}
    ) as run:
        init_key, measure_key = jax.random.split(jax.random.key(config.seed))
        state = jax.jit(baseline.init)(init_key)
        restored = run.restore(state)
        done, state = (0, state) if restored is None else restored
        with progress_lib.Progress(arena.title, config.num_steps, done=done) as progress:
            advance, evaluate = _compile(arena, config, state, progress)
            while done < config.num_steps:
                state, metrics = advance(state)
                done += per_row
                row, count = metrics_lib.summarise(metrics), done // per_row
                row["episodes"] = float(metrics["episodes"].sum())  # that ended since the last row
                is_last = done >= config.num_steps
                if count % config.evaluate_every == 0 or is_last:
                    key = jax.random.fold_in(measure_key, count)
                    found = metrics_lib.summarise(evaluate(baseline.policy(state), key))
                    found["reward"] = found["return"] / found["steps"]
                    row |= {f"eval/{name}": value for name, value in found.items()}
                run.log(done, row)
                progress.update(done, _shown(row))
                if count % config.checkpoint_every == 0 or is_last:
                    run.save(done, state)
        _finish(config, arena, run, state)


def measure(
    arena: Arena, policy: dict[str, Any], key: Key[Array, ""], num_episodes: int
) -> dict[str, Float[Array, ""]]:
    """Runs episodes without exploration; returns sums of their metrics and their number."""
    env_key, _ = jax.random.split(key)  # Acting draws nothing; splitting keeps the episodes.
    envs = jax.vmap(arena.env.reset)(jax.random.split(env_key, num_episodes))
    carries = jax.tree.map(lambda leaf: jnp.stack([leaf] * num_episodes), arena.baseline.start())

    def is_running(loop: tuple[base.EnvState, Any]) -> Array:
        return ~(loop[0].terminated | loop[0].truncated).all()

    def body(loop: tuple[base.EnvState, Any]) -> tuple[base.EnvState, Any]:
        envs, carries = loop
        ctrl, carries = jax.vmap(arena.baseline.act, (None, 0, 0))(policy, carries, envs.obs)
        return jax.vmap(arena.env.step)(envs, ctrl), carries

    envs, _ = jax.lax.while_loop(is_running, body, (envs, carries))
    sums = {f"sum_{name}": value.sum() for name, value in envs.metrics.items()}
    return sums | {"episodes": jnp.float32(num_episodes)}


def _compile(
    arena: Arena,
    config: config_lib.BaselineConfig,
    state: Any,
    progress: progress_lib.Progress,
) -> tuple[Callable, Callable]:
    """Compiles training and evaluation ahead, so that the time it takes can be told."""
    # Shapes alone: a state that was restored is the same program's as a new one.
    shapes = jax.eval_shape(lambda: state)
    policy, key = jax.eval_shape(lambda: (arena.baseline.policy(state), jax.random.key(0)))
    with progress.compiling("training"):
        advance = arena.advance.lower(shapes, config.log_rounds).compile()
    with progress.compiling("evaluation"):
        evaluate = arena.evaluate.lower(policy, key, config.num_eval_episodes).compile()
    return advance, evaluate


def _shown(row: dict[str, float]) -> dict[str, float]:
    """Picks what the progress bar shows."""
    names = {"eval/success": "success", "success": "while exploring"}
    return {
        short: row[name]
        for name, short in names.items()
        if name in row and math.isfinite(row[name])
    }


def _finish(
    config: config_lib.BaselineConfig, arena: Arena, run: run_folder.RunFolder, state: Any
) -> None:
    """Writes the policy of a run that has reached its end."""
    policies.save(
        run.path / policies.FOLDER,
        kind="baseline",
        params=arena.baseline.policy(state),
        meta={
            "method": config.method,
            "maze": config.maze,
            "robot": arena.env.robot.name,
            "side_xy": arena.side_xy,
            "config": dataclasses.asdict(config),
            "num_steps": int(state.num_steps),
            "versions": versions.describe(),
        },
        overwrite=True,
    )
