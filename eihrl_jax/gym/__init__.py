"""The mazes as Gymnasium environments, for learners from elsewhere; importing it registers them.

    import eihrl_jax.gym

    env = gymnasium.make("eihrl_jax/Ant-U-v0")
    env = gymnasium.make("eihrl_jax.gym:eihrl_jax/Maze-v0", maze="my_maze.txt", robot="point")
    envs = gymnasium.make_vec("eihrl_jax/Ant-U-v0", 64)  # one compiled step for all

`pip install eihrl_jax[gym]` brings Gymnasium; `docs/gymnasium.md` tells more.
"""

try:
    import gymnasium
except ImportError as error:
    raise ImportError("eihrl_jax.gym needs Gymnasium: pip install 'eihrl_jax[gym]'") from error

from eihrl_jax import mazes, robots
from eihrl_jax.gym import forks
from eihrl_jax.gym.high_level import HighLevelEnv, HighLevelVectorEnv
from eihrl_jax.gym.maze import MazeEnv, MazeVectorEnv

__all__ = [
    "HIGH_LEVEL_ID",
    "MAZE_ID",
    "HighLevelEnv",
    "HighLevelVectorEnv",
    "MazeEnv",
    "MazeVectorEnv",
    "register",
]

MAZE_ID = "eihrl_jax/Maze-v0"
"""Any robot in any maze, whose names are arguments."""

HIGH_LEVEL_ID = "eihrl_jax/HighLevel-v0"
"""The same by decisions: what learns here is a high level."""


def register() -> None:
    """Makes the ids known to Gymnasium, one per robot and maze of the paper among them."""
    forks.watch()
    known: dict[str, dict[str, str]] = {MAZE_ID: {}}
    for robot in robots.NAMES:
        for maze in mazes.NAMES:
            name = f"eihrl_jax/{robot.capitalize()}-{maze.capitalize()}-v0"
            known[name] = {"robot": robot, "maze": maze}

    for name, options in known.items():
        gymnasium.register(
            name,
            entry_point="eihrl_jax.gym.maze:MazeEnv",
            vector_entry_point="eihrl_jax.gym.maze:MazeVectorEnv",
            kwargs=options,
        )
    gymnasium.register(
        HIGH_LEVEL_ID,
        entry_point="eihrl_jax.gym.high_level:HighLevelEnv",
        vector_entry_point="eihrl_jax.gym.high_level:HighLevelVectorEnv",
    )


register()
