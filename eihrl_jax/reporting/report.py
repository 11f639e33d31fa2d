"""Puts everything that the paper reports on one page: `python -m experiments.report`."""

import dataclasses
import shlex

from eihrl_jax import base
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import report as report_config
from eihrl_jax.evaluation import tables
from eihrl_jax.reporting import comparison, page, sections
from eihrl_jax.runs import folders, versions
from eihrl_jax.storage import writing


def main(config: report_config.ReportConfig) -> None:
    """Evaluates what is missing, then writes the page.

    Raises:
      base.UserError: there is nothing to show, or another process is writing to the folder.
    """
    _check_places(config)
    with folders.locked(config.out):
        _write(config)


def _write(config: report_config.ReportConfig) -> None:
    """Evaluates what is missing in a folder that is ours alone, then writes the page."""
    runs = sections.Runs(config)
    made = [sections.PARTS[part](runs) for part in config.parts]
    shown = [section for section in made if section.tables or section.pictures]
    if not shown:
        # Two parts need a folder of runs, which has no default.
        needs = (("baselines", config.baselines), ("ablations", config.ablations))
        for part, folder in needs:
            if config.parts == (part,) and not folder:
                raise base.UserError(f"parts = {part} needs --{part}, a folder of runs")
        if config.parts == ("own",):
            raise base.UserError("parts = own needs --high, runs or names of policies")
        raise base.UserError(f"policies = {runs.folder} holds no <preset>-<maze>-<seed>")

    title, parts = "Zero-shot navigation", [*shown, _about(config)]
    page.write(config.out / "report.html", title, comparison.NOTE, parts)
    writing.write_text(config.out / "tables.md", page.markdown(shown))
    print(f"written to {config.out / 'report.html'}")


def _about(config: report_config.ReportConfig) -> page.Section:
    """Says when, with what and by which command the page was made."""
    made = versions.describe()
    packages = ", ".join(f"{name} {version}" for name, version in made["packages"].items())
    evaluated = evaluate_config.EvaluateConfig()
    rows = [
        ["date", made["date"]],
        ["commit", made["commit"] or "not from a checkout"],
        ["command", _command(config)],
        ["episodes per maze and high level", f"{config.episodes}, where nothing else is said"],
        ["evaluation seeds", ", ".join(map(str, evaluated.seeds))],
        ["machine", f"{made['system']}, {made['cpu']}, {made['device']}"],
        ["packages", packages],
    ]
    return page.Section(
        title="How this page was made",
        tables=[tables.Table("", ["", ""], rows, num_words=2)],
    )


def _command(config: report_config.ReportConfig) -> str:
    """Returns the command line with the options that aren't the defaults."""
    words = ["eihrl", "report"]
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if value != field.default:
            values = value if isinstance(value, tuple) else (value,)
            words += [f"--{field.name.replace('_', '-')}", *map(str, values)]
    return shlex.join(words)


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
