"""Hierarchical reinforcement learning for robots that find their way, end to end in JAX.

What one works with stands here. A name is imported when it is first used, so that importing the
package takes no time and touches no device.

| name | what it is |
|---|---|
| `load` | both levels by name, to be run in any maze |
| `load_maze`, `Maze` | one of the paper's mazes or a text file, as arrays |
| `load_robot` | one of the package's robots, or one of your own |
| `load_high`, `load_low` | trained policies, shipped ones by name |
| `OracleMaze`, `PhysicsMaze` | a robot moved by the simulator, or by its own controls |
| `Hierarchy` | a `PhysicsMaze` with a low level in it: its actions are directions |
| `train_high`, `train_low`, `evaluate` | what the commands of the same names do |
| `HighConfig`, `LowConfig`, `EvaluateConfig`, `presets` | their options, and named sets of them |
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eihrl_jax.config import presets as presets
    from eihrl_jax.config.evaluate import EvaluateConfig as EvaluateConfig
    from eihrl_jax.config.high import HighConfig as HighConfig
    from eihrl_jax.config.low import LowConfig as LowConfig
    from eihrl_jax.envs.hierarchy import Hierarchy as Hierarchy
    from eihrl_jax.envs.oracle_maze import OracleMaze as OracleMaze
    from eihrl_jax.envs.physics_maze import PhysicsMaze as PhysicsMaze
    from eihrl_jax.evaluation.loading import load_high as load_high
    from eihrl_jax.evaluation.loading import load_low as load_low
    from eihrl_jax.mazes import Maze as Maze
    from eihrl_jax.mazes import load as load_maze
    from eihrl_jax.reporting.evaluations import evaluate as evaluate
    from eihrl_jax.reporting.facade import load as load
    from eihrl_jax.reporting.trainers import train_high as train_high
    from eihrl_jax.reporting.trainers import train_low as train_low
    from eihrl_jax.robots import load as load_robot

__version__ = "0.2.0"

_PLACES = {
    "EvaluateConfig": "config.evaluate.EvaluateConfig",
    "Hierarchy": "envs.hierarchy.Hierarchy",
    "HighConfig": "config.high.HighConfig",
    "LowConfig": "config.low.LowConfig",
    "Maze": "mazes.Maze",
    "OracleMaze": "envs.oracle_maze.OracleMaze",
    "PhysicsMaze": "envs.physics_maze.PhysicsMaze",
    "evaluate": "reporting.evaluations.evaluate",
    "load": "reporting.facade.load",
    "load_high": "evaluation.loading.load_high",
    "load_low": "evaluation.loading.load_low",
    "load_maze": "mazes.load",
    "load_robot": "robots.load",
    "presets": "config.presets",
    "train_high": "reporting.trainers.train_high",
    "train_low": "reporting.trainers.train_low",
}

__all__ = [*_PLACES, "__version__"]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:  # Whatever stands in `_PLACES`.
    """Imports a public name when it is first used."""
    if name not in _PLACES:
        raise AttributeError(f"module 'eihrl_jax' has no attribute {name!r}")
    module, _, attribute = _PLACES[name].rpartition(".")
    value = getattr(importlib.import_module(f"eihrl_jax.{module}"), attribute, None)
    if value is None:  # The name of a module.
        value = importlib.import_module(f"eihrl_jax.{module}.{attribute}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Lists the public names."""
    return sorted(__all__)
