"""Measures docs/benchmarks.md: `python -m experiments.benchmark --out runs/benchmark`."""

import json
import pathlib
from collections.abc import Mapping
from typing import Annotated, Any

from eihrl_jax import base
from eihrl_jax.benchmarks import adapters, baselines, high, low, neighbours, physics
from eihrl_jax.benchmarks.part import Part
from eihrl_jax.config import limits
from eihrl_jax.runs import versions
from eihrl_jax.storage import writing

PARTS: dict[str, Part[Any]] = {
    "speed": Part(high.decisions_per_second, high.decisions_rows),
    "sizes": Part(high.decision_times, high.decision_rows),
    "interface": Part(physics.interface_ratio, physics.interface_rows),
    "maze_cost": Part(physics.maze_costs, physics.maze_costs_rows),
    "throughput": Part(physics.throughput, physics.throughput_rows),
    "engines": Part(physics.engine_deviations, physics.deviation_rows),
    "episodes": Part(high.full_episodes, high.episodes_rows),
    "walking": Part(low.walking_rate, low.walking_rows),
    "updates": Part(low.updates_per_second, low.updates_rows),
    "baselines": Part(baselines.higl_rate, baselines.higl_rows),
    "adapters": Part(adapters.adapter_costs, adapters.adapter_rows),
    "neighbours": Part(neighbours.ratios, neighbours.rows, ("jaxgcrl",)),
}
"""What can be measured, by name; each part has figures of its own kind, hence `Any`."""


@limits.dataclass
class BenchmarkConfig:
    """Measures speeds and the engines' divergence, and writes benchmark.json and benchmark.md.

    Run it on a machine that does nothing else; the figures stand beside the machine's name.

    Attributes:
      parts: what to measure; default: everything but updates, which needs sbx-rl installed,
        adapters, which needs Gymnasium and Brax, and neighbours, of which those are measured that
        are installed: Gymnasium-Robotics, Brax, sbx, and a checkout of JaxGCRL.
      out: folder of the results, must be new.
      jaxgcrl: checkout of JaxGCRL, for neighbours.
    """

    parts: limits.Several[Annotated[str, limits.OneOf(PARTS)]] = tuple(
        part for part in PARTS if part not in ("updates", "adapters", "neighbours")
    )
    out: pathlib.Path = pathlib.Path("runs/benchmark")
    jaxgcrl: pathlib.Path | None = None


def main(config: BenchmarkConfig) -> None:
    """Measures part by part, and writes all results so far after each.

    Raises:
      base.UserError: the folder exists already, or a part lacks a package.
    """
    # Never beside figures of another machine or version.
    if config.out.exists():
        raise base.UserError(f"out = {config.out} exists already; name a new folder")
    config.out.mkdir(parents=True)

    figures = {}
    for part in config.parts:
        print(f"measuring {part} ...", flush=True)
        options = {name: getattr(config, name) for name in PARTS[part].options}
        figures[part] = PARTS[part].measure(**options)
        document = {"machine": versions.describe(), "found": figures}
        writing.write_text(config.out / "benchmark.json", json.dumps(document, indent=2) + "\n")
        writing.write_text(config.out / "benchmark.md", markdown(figures))
    print(markdown(figures))


def markdown(figures: Mapping[str, Any]) -> str:
    """Returns the figures of some parts, as benchmark.json has them, as a Markdown table."""
    rows = {}
    for part, measured in figures.items():
        rows |= PARTS[part].rows(measured)
    lines = [f"| {what} | {result} |" for what, result in rows.items()]
    return "\n".join(["| what | measured |", "|---|---|", *lines]) + "\n"
