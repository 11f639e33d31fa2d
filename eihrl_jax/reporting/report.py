"""Puts everything that the paper reports on one page: `python -m experiments.report`."""

from eihrl_jax import base
from eihrl_jax.config import report as report_config
from eihrl_jax.reporting import comparison, page, sections
from eihrl_jax.runs import folders
from eihrl_jax.storage import writing


def main(config: report_config.ReportConfig) -> None:
    """Evaluates what is missing, then writes the page.

    Raises:
      base.UserError: there is nothing to show.
    """
    _check_places(config)
    runs = sections.Runs(config)
    made = [sections.PARTS[part](runs) for part in config.parts]
    shown = [section for section in made if section.tables or section.pictures]
    if not shown:
        # Two parts need a folder of runs, which has no default.
        for part, folders in (("baselines", config.baselines), ("ablations", config.ablations)):
            if config.parts == (part,) and not folders:
                raise base.UserError(f"parts = {part} needs --{part}, a folder of runs")
        raise base.UserError(f"policies = {runs.folder} holds no <preset>-<maze>-<seed>")

    config.out.mkdir(parents=True, exist_ok=True)
    page.write(config.out / "report.html", "Zero-shot navigation", comparison.NOTE, shown)
    writing.write_text(config.out / "tables.md", page.markdown(shown))
    print(f"written to {config.out / 'report.html'}")


def _check_places(config: report_config.ReportConfig) -> None:
    """Checks, before anything is evaluated, what is read and that nothing foreign is replaced."""
    named = [("policies", config.policies), ("baselines", config.baselines)]
    for option, folder in [*named, *(("ablations", each) for each in config.ablations)]:
        if folder is not None and not folder.is_dir():
            raise base.UserError(f"{option} = {folder} is no folder")

    # Ours may be taken up again.
    file = config.out / "report.html"
    if folders.holds_something(config.out) and file.exists() and not page.is_ours(file):
        raise base.UserError(f"{file} is no page of this command and is not overwritten")
