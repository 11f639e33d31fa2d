"""Options of the report: which high levels, and what of them is evaluated and shown."""

import pathlib
from typing import Annotated, Literal, get_args

from eihrl_jax import base
from eihrl_jax.config import limits

Part = Literal[
    "table1", "trained", "table2", "more_time", "learning", "baselines", "ablations", "own"
]
"""A part of the report, see `reporting.sections`."""

PARTS: tuple[Part, ...] = get_args(Part)


@limits.dataclass
class ReportConfig:
    """Evaluates trained high levels, and writes report.html and tables.md beside the paper's.

    Evaluations that the folder already holds are taken as they are, so that the command can be
    stopped and called again.

    Attributes:
      policies: folder of high levels, `<preset>-<maze>-<seed>` each, as `train_policies` makes
        them; None: those that are shipped.
      high: run folders, policy folders or shipped names of one's own choice, for the part own, in
        the mazes of --mazes.
      mazes: names, suites or files, as `evaluate` takes them.
      parts: what to evaluate and show; own is left out where no --high is named.
      movement: oracle: the simulator moves the torso; full: the robot walks, which takes most of
        the time.
      episodes: per maze and high level.
      slow_episodes: the same where swimmer or humanoid walk.
      num_rooms: generated rooms, one episode in each.
      ablations: folders of `ablate_high`, whose results are shown as they are.
      baselines: folder of runs of `compare_baselines`, `<method>-<maze>[-dense]-<seed>` each, whose
        learning is shown beside that of preset `best`.
      out: folder of the results.
    """

    policies: pathlib.Path | None = None
    high: tuple[str, ...] = ()
    mazes: limits.Several[str] = ("random", "g1", "g2", "g3")
    parts: limits.Several[Part] = PARTS
    movement: limits.Several[base.MovementName] = base.MOVEMENTS
    episodes: limits.UpToMillion = 500
    slow_episodes: limits.UpToMillion = 100
    num_rooms: Annotated[int, limits.Range(1, 100_000)] = 1_000
    ablations: tuple[pathlib.Path, ...] = ()
    baselines: pathlib.Path | None = None
    out: pathlib.Path = pathlib.Path("runs/report")
