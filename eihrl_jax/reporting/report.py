"""Puts everything that the paper reports on one page: `python -m experiments.report`."""

from eihrl_jax import base
from eihrl_jax.config import report as report_config
from eihrl_jax.reporting import comparison, page, sections


def main(config: report_config.ReportConfig) -> None:
    """Evaluates what is missing, then writes the page.

    Raises:
      base.UserError: there is nothing to show.
    """
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
    (config.out / "tables.md").write_text(page.markdown(shown))
    print(f"written to {config.out / 'report.html'}")
