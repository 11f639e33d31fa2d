"""Options of the high level's training: task, network, learner, and the run around them.

The paper doesn't give the learner's numbers. The defaults here are the preset `paper`; each option
names its source (see also `presets`).
"""

import pathlib
from typing import Annotated, ClassVar, Literal

from eihrl_jax import base
from eihrl_jax.config import checks, limits

RoomSide = Annotated[int, limits.Range(2, 100)]
"""Number of rows, or of columns, inside of a random room."""


@limits.dataclass
class Task:
    """The maze, the oracle's movement in it, and what the high level sees.

    Attributes:
      maze: name of a maze or path of a maze file (paper, Sec. 4.4: the Random Square).
      num_decisions: time limit in subgoals; None: the maze's own (paper, Table 3 divided by 25).
      robot: whose postures are drawn and whose radius stops at walls.
      reward: sparse pays 1 per goal region, dense 1 / (1 + distance) per decision (paper, D.2).
      extent: side of the view in units; three cells show the next move and the walls beside it.
      pixels: side of the view in pixels; 15 for 9 units are five per cell.
      step: units that a subgoal moves the body (paper, Table 4).
      sigma: standard deviation in units and per axis of the offset added to every move, the epsilon
        of the paper's epsilon-Invariant Randomization (Sec. 3.2); a tenth of the step is ours.
      measured: folder of `experiments.measure_low`, whose mean displacement, standard deviation and
        postures take the place of step, sigma and the shipped postures.
      num_postures: how many of the recorded postures are shown, the first ones; None: all.
      num_substeps: pieces in which a move is made, each stopped by walls.
      anchored: subgoals count from the middle of the robot's cell, so that offsets don't add up; in
        the paper they count from where the robot is.
      map_radius: cells to every side of the robot's on a map of all that has been in view, which
        the high level sees in place of the view itself; not in the paper. 0: no map.
      knows: what is on the map from the start: nothing, the cells of the goal, or the whole map.
      num_rooms: random rooms to train in instead of `maze`, others for every seed; 0: `maze`.
      room_sides: least and greatest number of rows and columns inside of such a room.
      room_walls: greatest share of inner wall in such a room.
    """

    maze: str = "random"
    num_decisions: limits.Decisions | None = None
    robot: str = "ant"
    reward: base.Reward = "sparse"
    extent: float = 9.0  # three cells
    pixels: int = 15  # five per cell
    step: float = base.CELL
    sigma: float = base.SIGMA
    measured: pathlib.Path | None = None
    num_postures: limits.UpToMillion | None = None
    num_substeps: int = 6  # of half a unit each at the paper's step
    anchored: bool = False
    map_radius: int = 0
    knows: base.Knows = "nothing"
    num_rooms: Annotated[int, limits.Range(0, 100_000)] = 0
    room_sides: tuple[RoomSide, RoomSide] = (5, 15)
    room_walls: float = 0.3

    def __post_init__(self) -> None:
        """Checks how the options fit together."""
        # Compared with the class's default: a maze that was named must not be passed over.
        if self.num_rooms and self.maze != type(self).maze:
            raise base.UserError(
                f"maze = {self.maze!r} and num_rooms = {self.num_rooms} exclude each other: "
                "training is in one maze, or in random rooms"
            )
        least, greatest = self.room_sides
        checks.in_range("room_sides", least, 2, greatest)
        checks.measured_alone(self.measured, self.step, self.sigma)


@limits.dataclass
class Network:
    """Kind and sizes of the actor-critic (paper, Figure 8 gives no sizes).

    Attributes:
      kind: patch: dense layers over tiles of the view; search: shortest ways on the map.
      tile: side in pixels of the tiles that the first layer looks at; divides the view.
      tile_features: outputs of the first layer per tile.
      hidden: widths of the dense layers that follow.
      num_iterations: of search, length in moves of the longest way that training looks at; once
        trained, it goes any way.
      look_ahead: of search, how many unseen cells on a way count for the worth of going there.
      cell_features: of search, width of the layer that looks at a cell.
      value_features: of search, width of the layer before the value.
      around: of search, what it looks at beside a cell itself: nothing, the four cells at its
        sides, or also the four at its corners.
    """

    kind: Literal["patch", "search"] = "patch"
    tile: Annotated[int, limits.Range(1, 256)] = 5  # one cell at five pixels per cell
    tile_features: Annotated[int, limits.Range(1, 1024)] = 16
    hidden: limits.Widths = (128,)
    num_iterations: Annotated[int, limits.Range(0, 1000)] = 24
    look_ahead: Annotated[int, limits.Range(0, 100)] = 3
    cell_features: Annotated[int, limits.Range(1, 1024)] = 8
    value_features: Annotated[int, limits.Range(1, 4096)] = 32
    around: Literal["nothing", "sides", "corners"] = "sides"

    RETIRED: ClassVar = ("optimism",)  # of value iteration networks, which search has replaced


@limits.dataclass
class Learner:
    """Numbers of PEG-A2C (paper, Algorithm 1).

    Attributes:
      num_workers: synchronous workers, n in the paper.
      window: decisions per worker and update, after which values stand for the rest; None: whole
        episodes and Monte-Carlo returns, as the paper has it.
      looks_beyond_limit: with a window, whether a value stands for what a time limit cut off, as it
        does with dense reward in any case; else the limit is an end as in Algorithm 1, and the
        policy learns to be in time.
      num_updates: updates in all; schedules end there.
      gamma: discount per decision (openai/baselines `a2c`).
      lambda_: weight of the returns that follow over the values; 1 is Algorithm 1.
      optimiser: as in openai/baselines `a2c`: RMSProp with decay 0.99 and epsilon 1e-5; or Adam.
      learning_rate: at the start (openai/baselines `a2c`).
      learning_rate_end: at the end, reached linearly (openai/baselines `a2c`: 0).
      entropy: weight of the entropy bonus at the start (openai/baselines `a2c`).
      entropy_end: at the end, reached linearly.
      value_coef: weight of the value's squared error (openai/baselines `a2c`).
      max_grad_norm: global norm to which gradients are clipped (openai/baselines `a2c`).
    """

    num_workers: Annotated[int, limits.Range(1, 2**20)] = 64
    window: Annotated[int, limits.Range(1, 10_000)] | None = None
    looks_beyond_limit: bool = False
    num_updates: limits.Count = 8000
    gamma: limits.Fraction = 0.99
    lambda_: limits.Fraction = 1.0
    optimiser: Literal["rmsprop", "adam"] = "rmsprop"
    learning_rate: limits.Rate = 7e-4
    learning_rate_end: limits.Fraction = 0.0
    entropy: Annotated[float, limits.Range(0.0, 10.0)] = 0.01
    entropy_end: Annotated[float, limits.Range(0.0, 10.0)] = 0.01
    value_coef: Annotated[float, limits.Range(0.0, 100.0)] = 0.5
    max_grad_norm: limits.Positive = 0.5


@limits.dataclass
class HighConfig:
    """A training run of the high level.

    Attributes:
      preset: where the defaults come from, best or paper.
      seed: of every random number of the run.
      run: run folder, made by the run.
      resume: continue the run that the folder holds.
      task: the maze and the view.
      network: sizes of the network.
      learner: numbers of PEG-A2C.
      log_every: updates per row of metrics, and per compiled piece of training.
      evaluate_every: updates between evaluations; a multiple of `log_every`.
      num_eval_episodes: episodes per evaluation, in the training maze.
      greedy: outside of learning, take the most likely subgoal instead of a sample.
      checkpoint_every: updates between checkpoints; a multiple of `log_every`.
      num_devices: devices of each process that share the workers; None: as many as can share
        them evenly. On CPU a core is a device.
      coordinator: host:port of process 0, for a run of several processes on one or more hosts;
        "auto": found in the environment of the cluster.
      num_processes: processes of the run.
      process_id: number of this process, from 0.

    >>> from eihrl_jax.config import presets
    >>> presets.HIGH["best"].task.maze
    'random'
    """

    preset: str = "paper"
    seed: limits.Seed = 0
    run: pathlib.Path = pathlib.Path("runs/high")
    resume: bool = False
    task: Task = Task()
    network: Network = Network()
    learner: Learner = Learner()
    log_every: int = 100
    evaluate_every: int = 1000
    num_eval_episodes: limits.UpToMillion = 500
    greedy: bool = False
    checkpoint_every: int = 1000
    num_devices: Annotated[int, limits.Range(1, 1024)] | None = None
    coordinator: str | None = None
    num_processes: int | None = None
    process_id: int | None = None

    def __post_init__(self) -> None:
        """Checks how the options fit together."""
        # Tiles without a rest, or the rim of the view would go unseen.
        if self.network.kind == "patch":
            checks.divides("tile", self.network.tile, "pixels", self.task.pixels)
        # A map and a patch have other shapes.
        if (self.network.kind == "patch") != (self.task.map_radius == 0):
            raise base.UserError(
                f"network kind = {self.network.kind!r} doesn't fit map_radius = "
                f"{self.task.map_radius}: a patch takes no map, search needs one"
            )

        # The pieces in which training is compiled: all else happens between two of them.
        checks.divides("log_every", self.log_every, "num_updates", self.learner.num_updates)
        checks.divides("log_every", self.log_every, "evaluate_every", self.evaluate_every)
        checks.divides("log_every", self.log_every, "checkpoint_every", self.checkpoint_every)
