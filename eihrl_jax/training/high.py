"""Training of the high level: PEG-A2C in a maze with oracle movement (paper, Sec. 3.2 and 4.1)."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from eihrl_jax import base, mazes, robots
from eihrl_jax.agents import peg_a2c
from eihrl_jax.config import checks
from eihrl_jax.config import high as high_config
from eihrl_jax.envs import oracle_maze, postures, raster, subgoals, wrappers
from eihrl_jax.mazes import generators
from eihrl_jax.networks import actor_critic
from eihrl_jax.runs import folders, policies, run_folder, versions
from eihrl_jax.runs import progress as progress_lib
from eihrl_jax.training import metrics as metrics_lib
from eihrl_jax.training import parallel

MAY_CHANGE = ("num_devices", "coordinator", "num_processes", "process_id")
"""Options that may differ between the processes of a run, and when it goes on."""

EVALUATION_STREAM = 1
"""Folded into the seed's key for evaluation, whose draws must not be those of training."""


def train(config: high_config.HighConfig, walking: base.Environment | None = None) -> float:
    """Trains a high level in a run folder, or goes on with a run that was stopped.

    The run folder ends up with the policy. In a run of several processes all must call this; the
    first one writes.

    Args:
      config: the run's options.
      walking: where evaluations are made a second time, as `walking/` beside `eval/`: the same task
        with a robot that walks.

    Returns:
      Seconds of training past compilation, evaluations and checkpoints included.

    Raises:
      base.UserError: an option or the run folder is not as it should be.
    """
    folders.check_free(config.run, resume=config.resume)  # before anything slow
    parallel.connect(config.coordinator, config.num_processes, config.process_id)
    env = make_env(config.task, config.seed)
    agent = make_agent(env, config)
    mesh = parallel.make_mesh(config.num_devices, config.learner.num_workers)
    with run_folder.RunFolder.create(
        config.run, config, resume=config.resume, may_change=MAY_CHANGE
    ) as run:
        state = parallel.init(agent, config.seed, mesh)
        restored = run.restore(state)
        done, state = (0, state) if restored is None else restored
        num_updates, per_update = config.learner.num_updates, decisions_per_update(agent)
        title = f"{_title(config.task)} high level"
        with progress_lib.Progress(
            title,
            num_updates * per_update,
            unit="decisions",
            done=done * per_update,
        ) as progress:
            with progress.compiling("training"):
                update = parallel.repeated_update(agent, config.log_every, mesh)
                advance = update.lower(state).compile()
            with progress.compiling("evaluation"):
                envs = {"eval": env} | ({} if walking is None else {"walking": walking})
                limit = int(env.table.mazes.num_decisions.max())
                evaluate = _compile_evaluations(envs, limit, config, state)
            while done < num_updates:
                state, metrics = advance(state)
                done += config.log_every
                is_last = done == num_updates
                row = {"num_decisions": int(state.num_decisions)} | summarise(metrics)
                row["episodes"] = float(metrics["episodes"].sum())  # that ended since the last row
                if done % config.evaluate_every == 0 or is_last:
                    row |= evaluate(state)
                run.log(done, row)
                progress.update(done * per_update, _shown(row))
                if done % config.checkpoint_every == 0 or is_last:
                    run.save(done, state)
            seconds = progress.seconds
        _finish(config, env, run, state)
    return seconds


def make_env(task: high_config.Task, seed: int = 0) -> oracle_maze.OracleMaze:
    """Builds the maze with oracle movement; it doesn't reset itself.

    Args:
      task: maze, movement and view.
      seed: which lot of random rooms is made, where the task asks for some.

    Raises:
      base.UserError: the maze or the robot is unknown, or numbers don't fit together.
    """
    robot = robots.load(task.robot)
    view = raster.View(extent=task.extent, pixels=task.pixels, map_radius=task.map_radius)
    step, sigma, bank = subgoals.gait(robot, task.measured, task.step, task.sigma)
    movement = oracle_maze.Movement(
        step=step,
        sigma=sigma,
        num_substeps=task.num_substeps,
        body_radius=robot.body_radius,
    )
    return oracle_maze.OracleMaze(
        _mazes(task, seed),
        postures.footprints(robot, bank, view)[: task.num_postures],
        view=view,
        movement=movement,
        reward=task.reward,
    )


def make_agent(env: oracle_maze.OracleMaze, config: high_config.HighConfig) -> peg_a2c.PegA2C:
    """Builds the learner of a maze.

    Raises:
      base.UserError: the window is longer than an episode, or there are more decisions than can be
        counted.
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
        # What is paid until the limit depends on the time left, which nobody sees: values that end
        # there are noise, and with it the Random Square was learned to 40 % where it is to 97 %.
        learner = dataclasses.replace(learner, looks_beyond_limit=True)
    agent = peg_a2c.PegA2C(trained_in, network, learner, window or int(limits.max()))
    most = (2**31 - 1) // decisions_per_update(agent)  # Decisions are counted in 32 bits.
    checks.in_range("num_updates", config.learner.num_updates, 1, most)
    return agent


def decisions_per_update(agent: peg_a2c.PegA2C) -> int:
    """Returns the decisions of an update; with whole episodes the most that there can be."""
    return agent.horizon * agent.learner.num_workers


def summarise(metrics: Mapping[str, Any]) -> dict[str, float]:
    """Turns the metrics of some updates, see `PegA2C.update`, into numbers.

    Returns:
      Means over the episodes that ended, NaN where none did, and means over the updates.
    """
    counted = {name: values for name, values in metrics.items() if name != "decisions"}
    return metrics_lib.summarise(counted)


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
    """Names what is trained in."""
    return f"{task.num_rooms} random rooms" if task.num_rooms else task.maze


def _compile_evaluations(
    envs: Mapping[str, base.Environment],
    limit: int,
    config: high_config.HighConfig,
    state: peg_a2c.LearnerState,
) -> Callable[[peg_a2c.LearnerState], dict[str, float]]:
    """Compiles an evaluation in each of some environments, which gives its metrics their prefix."""
    compiled = {name: _compile_evaluation(env, limit, config, state) for name, env in envs.items()}

    def evaluate(state):
        found = {name: measure(state) for name, measure in compiled.items()}
        return {f"{name}/{key}": value for name in found for key, value in found[name].items()}

    return evaluate


def _compile_evaluation(
    env: base.Environment, limit: int, config: high_config.HighConfig, state: peg_a2c.LearnerState
) -> Callable[[peg_a2c.LearnerState], dict[str, float]]:
    """Compiles whole episodes of up to `limit` decisions, subgoals sampled."""
    whole = dataclasses.replace(config.learner, window=None)
    agent = peg_a2c.PegA2C(env, actor_critic.make(config.network), whole, limit)
    stream = jax.random.fold_in(jax.random.key(config.seed), EVALUATION_STREAM)

    def measure(params, num_updates):
        keys = jax.random.split(jax.random.fold_in(stream, num_updates), config.num_eval_episodes)
        _, _, counts = jax.vmap(agent.collect_episode, (None, 0))(params, keys)
        return jax.tree.map(jnp.sum, counts)

    compiled = jax.jit(measure).lower(*_local((state.params, state.num_updates))).compile()

    def evaluate(state):
        found = summarise(compiled(*_local((state.params, state.num_updates))))
        found["reward"] = found["return"] / found["decisions"]
        return found

    return evaluate


def _local(tree: Any) -> Any:
    """Returns this process's first copy of arrays that are the same everywhere."""
    return jax.tree.map(lambda leaf: leaf.addressable_data(0), tree)


def _shown(row: Mapping[str, float]) -> dict[str, float]:
    """Picks what the progress bar shows."""
    return {name: row[name] for name in ("success", "entropy") if name in row}


def _finish(
    config: high_config.HighConfig,
    env: oracle_maze.OracleMaze,
    run: run_folder.RunFolder,
    state: peg_a2c.LearnerState,
) -> None:
    """Writes the policy of a run that has reached its end."""
    policies.save(
        run.path / policies.FOLDER,
        kind="high",
        params=state.params,
        meta={
            "maze": _title(config.task),
            "robot": robots.load(config.task.robot).name,
            "view": dataclasses.asdict(env.view),
            "network": dataclasses.asdict(config.network),
            "movement": {"step": env.movement.step, "sigma": env.movement.sigma},
            "config": dataclasses.asdict(config.task) | dataclasses.asdict(config.learner),
            "num_updates": int(state.num_updates),
            "num_decisions": int(state.num_decisions),
            "versions": versions.describe(),
        },
        overwrite=True,
    )
