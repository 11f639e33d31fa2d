"""Options of an evaluation: which agents, in which mazes, how many episodes."""

import pathlib
from typing import Literal

from eihrl_jax import base
from eihrl_jax.config import checks, limits
from eihrl_jax.config import reading as reading_config

Animate = Literal["one", "all", "failed", "none"]
"""Which evaluations are animated, see `EvaluateConfig`."""

Camera = Literal["auto", "whole", "follow"]
"""What an animation shows, see `EvaluateConfig`."""

FilmFormat = Literal["gif", "mp4"]
"""Of an animation."""

UNIFORM = "uniform"
"""What the high level is called that chooses directions uniformly (the paper's RAND-H)."""

FRONTIER = "frontier"
"""What the high level is called that goes to the nearest cell not seen yet, without learning."""

SHORTEST = "shortest"
"""What the high level is called that knows the map and goes the shortest way to a goal."""

UNIFORM_NAMES = (UNIFORM, "random")
"""What `--high` takes for it; "random" is the name that it once had, now a maze's alone."""


@limits.dataclass
class EvaluateConfig:
    """Evaluates two-level agents in mazes: every robot x movement x high level in every maze.

    Success is achieved goals / total goals, with 95 % intervals. Writes eval.json, episodes.csv,
    tables.md, a heatmap per maze, and an animation.

    Attributes:
      mazes: names (random, u, s, spiral, g1, g2, g3), suites (paper, jaxued, ogbench, jaxgcrl,
        gymnasium-robotics, perfect-19, perfect-51, perfect-101, development), names of mazes in
        them, such as jaxued-labyrinth, or text files; default: Table 1 of the paper.
      robot: point, ant, swimmer, humanoid, go1 or description files (docs/robots.md).
      movement: oracle: the simulator moves the torso; full: the robot itself, with a low level.
      high: run folders, policy folders or names of shipped policies, such as best-u-0 (all of them:
        `eihrl list`); uniform: uniform directions;
        frontier: the nearest cell that hasn't been seen, on the same map as network kind search;
        shortest: the shortest way to the nearest goal, as the map, which it knows, has it.
        A baseline's run folder stands for the whole baseline, which has full movement only.
      low: low level of each robot for full movement, like `high`; none: the robots' shipped ones.
      stand: the low level that takes over while a robot is down, like `low`, or "none"; by default
        the one beside its low level, if there is one.
      reward: of the task, in which returns are counted; with dense reward episodes last until their
        time limit (paper, D).
      episodes: per maze and seed.
      seeds: of the evaluation's random numbers; each runs all episodes anew.
      out: folder of the results; must be new or empty.
      num_decisions: time limit in subgoals; none: each maze's own.
      greedy: take the most likely direction, also where the high level's preset takes a sample.
      sampled: take a sample, also where the high level's preset takes the most likely direction.
      step: units that oracle movement goes per subgoal.
      sigma: standard deviation in units and per axis of the oracle's random offset.
      anchored: subgoals count from the middle of the robot's cell; none: as in the high level's own
        training, but not where the robot's description says that its low level doesn't know them.
      knows: what is on the map from the start: nothing, the cells of the goal, or the whole map;
        none: as in the high level's own training.
      measured: folder of `experiments.measure_low`, whose mean displacement, standard deviation and
        postures take the place of step, sigma and the shipped postures.
      engine: physics engine of full movement.
      reading: what the mazes' files leave open, such as start and goal.
      animate: an animation of one maze, of all, of an episode that failed in each, or of none.
      format: of the animations; mp4 needs the package imageio-ffmpeg.
      camera: sees the whole maze, or follows the robot with a small plan beside it; auto: follows
        where the robot would be small.
      quick: a first look: 20 episodes, full movement alone and no heatmaps, where nothing else is
        asked for.
      heatmaps: draw where the robot was, one picture per maze and agent, and where those episodes
        ended that failed.

    >>> EvaluateConfig(mazes=("u", "spiral"), episodes=100).seeds
    (0,)
    """

    mazes: limits.Several[str] = ("random", "g1", "g2", "g3")
    robot: limits.Several[str] = ("ant",)
    movement: limits.Several[base.MovementName] = base.MOVEMENTS
    high: limits.Several[str] = ("best-random-0",)
    low: tuple[str, ...] = ()
    stand: str | None = None
    reward: base.Reward = "sparse"
    episodes: limits.UpToMillion = 500  # which the paper's percentages point at, see `statistics`
    seeds: limits.Seeds = (0,)
    out: pathlib.Path = pathlib.Path("runs/evaluation")
    num_decisions: limits.Decisions | None = None
    greedy: bool = False
    sampled: bool = False
    step: float = base.CELL
    sigma: float = base.SIGMA
    anchored: bool | None = None
    knows: base.Knows | None = None
    measured: pathlib.Path | None = None
    engine: base.EngineName = "mujoco"
    reading: reading_config.ReadingConfig = reading_config.ReadingConfig()
    animate: Animate = "one"
    format: FilmFormat = "gif"
    camera: Camera = "auto"
    heatmaps: bool = True
    quick: bool = False

    def __post_init__(self) -> None:
        """Checks how the options fit together."""
        checks.measured_alone(self.measured, self.step, self.sigma)
        self._check_movement()
        if self.greedy and self.sampled:
            raise base.UserError("greedy and sampled exclude each other: give one, or none")
        # Low levels belong to robots by their order.
        if self.low and len(self.low) != len(self.robot):
            raise base.UserError(
                f"low names {len(self.low)} policies for {len(self.robot)} robots; "
                "give one for each robot, or none"
            )

    def _check_movement(self) -> None:
        """Checks that options of one kind of movement come with it."""
        for name in ("step", "sigma", "measured"):
            # A value equal to the default counts as not given.
            value, default = getattr(self, name), getattr(type(self), name)
            if value != default and "oracle" not in self.movement:
                raise base.UserError(f"{name} = {value} needs movement oracle, not only full")
        if self.low and "full" not in self.movement:
            raise base.UserError(f"low = {self.low[0]} needs movement full, not only oracle")
