"""Measures what the README claims: `python -m experiments.benchmark --out runs/benchmark`."""

import dataclasses
import json
import pathlib
from collections.abc import Callable
from typing import Any, Literal, get_args

import jax

from eihrl_jax import base
from eihrl_jax.benchmarks import baselines, high, low, physics
from eihrl_jax.config import checks
from eihrl_jax.runs import versions

Part = Literal[
    "speed",
    "interface",
    "maze_cost",
    "throughput",
    "engines",
    "episodes",
    "walking",
    "updates",
    "baselines",
]

_BATCHES, _CPU_BATCHES = (64, 1024, 8192), (16, 64, 256)
"""Ants at once."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class BenchmarkConfig:
    """Measures speeds, and how far the engines part, and writes benchmark.json and benchmark.md.

    Run it on a machine that does nothing else; the figures stand beside the machine's name.

    Attributes:
      parts: what to measure; default: everything but updates, which needs sbx-rl installed.
      out: folder of the results, must be new.
    """

    parts: tuple[Part, ...] = tuple(part for part in get_args(Part) if part != "updates")
    out: pathlib.Path = pathlib.Path("runs/benchmark")

    def __post_init__(self) -> None:
        """Checks that there is something to do."""
        checks.each_of("parts", self.parts, get_args(Part))


def main(config: BenchmarkConfig) -> None:
    """Measures part by part, and writes what is there after each."""
    if config.out.exists():
        raise base.UserError(f"out = {config.out} exists already; name a new folder")
    config.out.mkdir(parents=True)
    found: dict[str, Any] = {}
    for part in config.parts:
        print(f"measuring {part} ...", flush=True)
        found[part] = _measures(config)[part]()
        document = {"machine": versions.describe(), "found": found}
        (config.out / "benchmark.json").write_text(json.dumps(document, indent=2) + "\n")
        (config.out / "benchmark.md").write_text(markdown(found))
    print(markdown(found))


def _measures(config: BenchmarkConfig) -> dict[str, Callable[[], Any]]:
    return {
        "speed": high.decisions_per_second,
        "interface": physics.interface_ratio,
        "maze_cost": lambda: {
            # A step of MJX takes fifty times as long on a processor.
            name: physics.maze_cost_ratio(name, num_envs=num_envs, repeats=repeats)
            for name, num_envs, repeats in (("mujoco", 256, 15), ("mjx", 32, 12))
        },
        "throughput": lambda: physics.throughput(
            _CPU_BATCHES if jax.default_backend() == "cpu" else _BATCHES
        ),
        "engines": physics.engine_deviations,
        "walking": low.walking_rate,
        "updates": low.updates_per_second,
        "baselines": baselines.higl_rate,
        "episodes": lambda: high.full_episodes_seconds(config.out / "episodes", "best-random-0"),
    }


def markdown(found: dict[str, Any]) -> str:
    """Returns the figures as a Markdown table; `found` holds the results by part."""
    rows = [line for part, result in found.items() for line in _rows(part, result)]
    return "\n".join(["| what | measured |", "|---|---|", *rows]) + "\n"


def _rows(part: str, result: Any) -> list[str]:
    if part == "speed":
        return [
            f"| decisions per second, environment and learning, {kind} | "
            f"{rates['median']:,.0f} (median), {rates['fastest']:,.0f} (fastest) |"
            for kind, rates in result.items()
        ]
    if part == "interface":
        return [
            "| C engine behind the interface against `mujoco.batch` alone, 1024 ants | "
            f"{100 * result['ratio']:.0f} % of {result['alone']:,.0f} control steps/s |"
        ]
    if part == "maze_cost":
        return [
            f"| cost of a control step, Spiral against Random Square, {name} | "
            f"{100 * (item['ratio'] - 1):+.1f} % |"
            for name, item in result.items()
        ]
    if part == "throughput":
        return [
            f"| {row['num_envs']:,} ants at once, {row['engine']} | "
            f"{row['rate']:,.0f} control steps/s |"
            for row in result
        ]
    if part == "engines":
        return [_engines_row(row) for row in result]
    if part == "walking":
        return [
            "| ants that walk with the policy in the loop against the engine alone, 64 ants | "
            f"{100 * result['ratio']:.0f} % of {result['engine']:,.0f} control steps/s |"
        ]
    if part == "updates":
        return [
            "| DroQ updates per second, batch 256, actor every 20th | "
            f"{result['ours']:,.0f}; sbx {result['sbx']:,.0f}: {result['ratio']:.2f} times; "
            f"{100 * result['of_limit']:.0f} % of what {result['gflops']:,.0f} GFLOP/s allow |"
        ]
    if part == "baselines":
        return [
            "| HIGL with its own settings, learning included | "
            f"{result['rate']:.0f} control steps/s, {result['ratio']:.1f} times the published |"
        ]
    return [
        "| 500 episodes of the walking ant on the Random Square, past compilation | "
        f"{result['seconds']:.0f} s, success {100 * result['success']:.1f} % |"
    ]


def _engines_row(row: dict[str, Any]) -> str:
    where = "at walls" if row["walls"] else "on open floor"
    numbers = ", ".join(f"{name} {row[name]:.0e}" for name in ("median", "p90", "max"))
    return f"| MJX against MuJoCo C, 50 control steps {where}, {row['comparison']} | {numbers} |"
