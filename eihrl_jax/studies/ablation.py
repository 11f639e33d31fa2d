"""Trainings of a preset with one thing changed at a time, each with several seeds."""

import dataclasses
import functools
import itertools
import pathlib
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Generic

from eihrl_jax.config import changes
from eihrl_jax.reporting import cached_runs
from eihrl_jax.reporting.cached_runs import RunT


@dataclasses.dataclass(frozen=True, kw_only=True)
class Ablation(Generic[RunT]):
    """The runs of an ablation, `<out>/<variant>/seed-<seed>` each.

    Attributes:
      preset: options of all runs.
      variants: what is changed, by name, see `changes.apply`.
      seeds: of the runs of each variant.
      out: folder of the runs.
    """

    preset: RunT
    variants: Mapping[str, Mapping[str, object]]
    seeds: tuple[int, ...]
    out: pathlib.Path

    def options(self, variant: str, seed: int) -> RunT:
        """Returns the options of one run."""
        run = self.out / folder(variant) / f"seed-{seed}"
        own = {"seed": seed, "run": run, "resume": True}
        return changes.apply(self.preset, {**own, **self.variants[variant]})

    def runs(self, variant: str) -> list[RunT]:
        """Lists the options of a variant's runs, by seed."""
        return [self.options(variant, seed) for seed in self.seeds]

    def train(self, variants: Iterable[str], train: Callable[[RunT], object]) -> None:
        """Trains what isn't finished, the first seed of everything first, see `share`."""
        cached_runs.share(
            functools.partial(cached_runs.finish, self.options(variant, seed), train)
            for seed, variant in itertools.product(self.seeds, variants)
        )

    def finished(self) -> dict[str, list[pathlib.Path]]:
        """Returns the metrics of all finished runs by variant; no variant without any."""
        # Also of variants that aren't asked for this time: the folder is compared as a whole.
        metrics = {
            variant: [
                options.run / "metrics.csv"
                for options in self.runs(variant)
                if cached_runs.is_finished(options)
            ]
            for variant in self.variants
        }
        return {variant: files for variant, files in metrics.items() if files}


def folder(variant: str) -> str:
    """Returns a variant's name as that of a folder: "eq. 1" as "eq-1"."""
    return re.sub(r"[.:]? ", "-", variant)
