"""Trains, evaluates and steps vector environments in turn, for long, in one process.

What it holds of the machine, memory, threads and open files, must not grow: `make soak`.
"""

import dataclasses
import gc
import json
import os
import pathlib
import shutil
import sys
import time
from typing import Annotated

import jax
import numpy as np

from eihrl_jax import base
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import high as high_config
from eihrl_jax.config import limits
from eihrl_jax.evaluation import tables
from eihrl_jax.gym import maze
from eihrl_jax.reporting import evaluations, trainers
from eihrl_jax.runs import folders, versions
from eihrl_jax.storage import writing

MAX_GROWTH = 1.0
"""Per cent of its memory by which a process may grow in an hour, once it is warm."""

_WARM = 0.25  # share of the rounds that count as warming up
_NUM_ENVS, _NUM_STEPS = 8, 200


@limits.dataclass
class SoakConfig:
    """Trains, evaluates and steps vector environments in turn, and watches memory.

    Attributes:
      minutes: how long.
      out: folder of the figures; must be new or empty.
    """

    minutes: Annotated[float, limits.Range(above=0.0, high=10_000.0)] = 60.0
    out: pathlib.Path = pathlib.Path("runs/soak")


@dataclasses.dataclass(frozen=True)
class Held:
    """What the process holds after a round.

    Attributes:
      seconds: since the beginning.
      mebibytes: resident memory.
      threads: of the system.
      files: that are open.
    """

    seconds: float
    mebibytes: float
    threads: int
    files: int

    @classmethod
    def now(cls, began: float) -> "Held":
        """Returns what is held at this moment, by what Linux tells of a process."""
        with open("/proc/self/statm", encoding="ascii") as file:
            pages = int(file.read().split()[1])
        return cls(
            seconds=round(time.monotonic() - began, 1),
            mebibytes=round(pages * os.sysconf("SC_PAGE_SIZE") / 2**20, 1),
            threads=len(os.listdir("/proc/self/task")),
            files=len(os.listdir("/proc/self/fd")),
        )


def main(options: SoakConfig) -> None:
    """Goes round until the time is over; ends with exit code 1 where anything grows."""
    if not pathlib.Path("/proc/self/statm").exists():
        raise base.UserError("soak: what a process holds is only known on Linux")
    with folders.reserved(options.out):
        rounds: list[Held] = []
        began = time.monotonic()
        while len(rounds) < 4 or rounds[-1].seconds < 60.0 * options.minutes:
            _round(options.out / "round", len(rounds))
            rounds.append(Held.now(began))
            print(f"round {len(rounds)}: {rounds[-1]}", flush=True)

        warm = rounds[int(_WARM * len(rounds)) :]
        growth = growth_per_hour(warm)
        about = {"growth_per_hour": growth, "versions": versions.describe()}
        document = about | {"rounds": [dataclasses.asdict(each) for each in rounds]}
        writing.write_text(options.out / "soak.json", json.dumps(document, indent=1) + "\n")

    first, last = warm[0], warm[-1]
    header = ["once warm", "first", "last", "growth per hour"]
    memory = ["memory, MiB", f"{first.mebibytes:.0f}", f"{last.mebibytes:.0f}", f"{growth:+.2f} %"]
    counted = [
        [name, str(getattr(first, name)), str(getattr(last, name)), "-"]
        for name in ("threads", "files")
    ]
    tables.show([tables.on_terminal(tables.Table("", header, [memory, *counted]))])
    has_more = last.threads > first.threads or last.files > first.files
    sys.exit(growth >= MAX_GROWTH or has_more)


def growth_per_hour(rounds: list[Held]) -> float:
    """Returns how fast memory grows, per cent of its mean per hour, by the line of least squares.

    >>> rounds = [Held(1800.0 * i, 100.0 + i, 9, 9) for i in range(3)]
    >>> round(growth_per_hour(rounds), 2)
    1.98
    """
    hours = np.array([each.seconds for each in rounds]) / 3600.0
    memory = np.array([each.mebibytes for each in rounds])
    slope = np.polyfit(hours, memory, 1)[0]
    return float(100.0 * slope / memory.mean())


def _round(folder: pathlib.Path, seed: int) -> None:
    """Does a little of everything, and leaves nothing."""
    learner = high_config.Learner(num_workers=4, window=4, num_updates=20)
    task = high_config.Task(maze="u", robot="point")
    trainers.train_high(
        high_config.HighConfig(
            run=folder / "run",
            seed=seed,
            task=task,
            learner=learner,
            num_eval_episodes=4,
            log_every=10,
            evaluate_every=10,
            checkpoint_every=10,
        )
    )
    evaluations.evaluate(
        evaluate_config.EvaluateConfig(
            mazes=("u",),
            robot=("point",),
            movement=("oracle",),
            high=(str(folder / "run"),),
            episodes=10,
            animate="none",
            seeds=(seed,),
            out=folder / "evaluation",
        )
    )

    envs = maze.MazeVectorEnv(_NUM_ENVS, "u", "point", num_decisions=10)
    envs.reset(seed=seed)
    for _ in range(_NUM_STEPS):
        envs.step(envs.action_space.sample())
    envs.close()

    shutil.rmtree(folder)
    # JAX keeps compiled programs for further calls, of which there are none here.
    jax.clear_caches()
    gc.collect()
