"""Puts everything that the paper reports on one page: `python -m experiments.report`."""

import pathlib
from typing import Annotated

from eihrl_jax import base
from eihrl_jax.config import limits
from eihrl_jax.reporting import comparison, page, sections
from eihrl_jax.runs import policies


@limits.dataclass
class ReportConfig:
    """Evaluates trained high levels, and writes report.html and tables.md beside the paper's.

    Evaluations that the folder already holds are taken as they are, so that the command can be
    stopped and called again.

    Attributes:
      policies: folder of high levels, `<preset>-<maze>-<seed>` each, as `train_policies` makes
        them; None: those that are shipped.
      parts: what to evaluate and show.
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
    parts: limits.Several[Annotated[str, limits.OneOf(sections.PARTS)]] = tuple(sections.PARTS)
    movement: limits.Several[base.MovementName] = base.MOVEMENTS
    episodes: limits.UpToMillion = 500
    slow_episodes: limits.UpToMillion = 100
    num_rooms: Annotated[int, limits.Range(1, 100_000)] = 1_000
    ablations: tuple[pathlib.Path, ...] = ()
    baselines: pathlib.Path | None = None
    out: pathlib.Path = pathlib.Path("runs/report")


def main(config: ReportConfig) -> None:
    """Evaluates what is missing, then writes the page."""
    runs = sections.Runs(
        folder=policies.PRETRAINED if config.policies is None else config.policies,
        out=config.out,
        movement=config.movement,
        episodes=config.episodes,
        slow_episodes=config.slow_episodes,
        num_rooms=config.num_rooms,
        ablations=config.ablations,
        baselines=config.baselines,
    )
    found = [sections.PARTS[part](runs) for part in config.parts]
    shown = [section for section in found if section.tables or section.pictures]
    if not shown:
        for part, folders in (("baselines", config.baselines), ("ablations", config.ablations)):
            if config.parts == (part,) and not folders:
                raise base.UserError(f"parts = {part} needs --{part}, a folder of runs")
        raise base.UserError(f"policies = {runs.folder} holds no <preset>-<maze>-<seed>")
    config.out.mkdir(parents=True, exist_ok=True)
    page.write(config.out / "report.html", "Zero-shot navigation", comparison.NOTE, shown)
    (config.out / "tables.md").write_text(page.markdown(shown))
    print(f"written to {config.out / 'report.html'}")
