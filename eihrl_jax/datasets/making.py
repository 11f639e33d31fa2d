"""Builds from a dataset's options the hierarchy that acts and the environment that is recorded."""

import dataclasses
from typing import NamedTuple

import gymnasium

import eihrl_jax.gym
from eihrl_jax import robots
from eihrl_jax.config.dataset import DatasetConfig
from eihrl_jax.datasets import episodes
from eihrl_jax.envs import oracle_maze
from eihrl_jax.evaluation import loading
from eihrl_jax.gym import places
from eihrl_jax.gym.envs import SingleEnv
from eihrl_jax.gym.episodes import Task
from eihrl_jax.gym.high_level import HighLevelTask
from eihrl_jax.gym.maze import MazeTask


class Made(NamedTuple):
    """What a dataset is made with.

    Attributes:
      recorder: runs episodes.
      env: the Gymnasium environment whose episodes they are; nothing of it is compiled.
    """

    recorder: episodes.Recorder
    env: gymnasium.Env


def make(config: DatasetConfig) -> Made:
    """Loads robot, maze and levels.

    Raises:
      base.UserError: one of them is unknown, damaged, or doesn't fit the others.
    """
    high = loading.load_high(config.high)
    if config.movement == "full":
        return _walking(config, high)
    return _by_oracle(config, high)


def _walking(config: DatasetConfig, high: loading.HighLevel) -> Made:
    """Returns a robot that walks."""
    env = gymnasium.make(
        eihrl_jax.gym.MAZE_ID,
        maze=config.maze,
        robot=config.robot,
        reward=config.reward,
        engine=config.engine,
        num_decisions=config.num_decisions,
        observation=config.observation,
    )
    task = _task_of(env)
    assert isinstance(task, MazeTask)

    stacked = task.maze.stacked()
    levels = loading.full_env(
        places.engine_of(task.robot, config.engine),
        stacked,
        high.view_in(stacked),
        loading.load_low(config.low or config.robot, task.robot),
        anchored=high.anchors(task.robot),
        reward=config.reward,
    )
    return Made(episodes.Walking(high, levels, task.environment(), task), env)


def _by_oracle(config: DatasetConfig, high: loading.HighLevel) -> Made:
    """Returns a robot that the simulator moves; of a map its high level sees as in training."""
    view = dataclasses.asdict(high.view)
    env = gymnasium.make(
        eihrl_jax.gym.HIGH_LEVEL_ID,
        maze=config.maze,
        robot=config.robot,
        movement="oracle",
        reward=config.reward,
        num_decisions=config.num_decisions,
        anchored=high.anchors(robots.load(config.robot)),
        **{name: view[name] for name in ("extent", "pixels", "map_radius", "knows")},
    )
    task = _task_of(env)
    assert isinstance(task, HighLevelTask)

    bare = task.environment()
    assert isinstance(bare, oracle_maze.OracleMaze)
    return Made(episodes.ByOracle(high, bare, task), env)


def _task_of(env: gymnasium.Env) -> Task:
    """Returns what one of our Gymnasium environments shows."""
    assert isinstance(env.unwrapped, SingleEnv)
    return env.unwrapped.task
