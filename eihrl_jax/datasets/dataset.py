"""Writes a dataset: episodes in parts while it runs, and then as one that Minari reads.

What is unfinished lies beside the dataset's folder, under a hidden name: a run folder with a file
of every finished batch. A run that is killed at any moment goes on after the last of them; the
dataset itself is there whole or not at all.
"""

import pathlib
import re

from eihrl_jax import base
from eihrl_jax.config.dataset import DatasetConfig
from eihrl_jax.datasets import making, minari_files, parts
from eihrl_jax.runs import progress as progress_lib
from eihrl_jax.runs import run_folder
from eihrl_jax.storage import writing

_PARTS, _STAGING = "parts", "datasets"


def name_of(config: DatasetConfig) -> str:
    """Returns a dataset's id."""
    if config.name is not None:
        return config.name
    # Files are known by their stems; an id takes letters, digits, - and _ alone.
    robot, maze = (
        re.sub(r"[^-\w]", "_", pathlib.PurePath(each).stem) for each in (config.robot, config.maze)
    )
    walking = {"full": "walking", "oracle": "oracle"}[config.movement]
    return f"eihrl_jax/{robot}-{maze}/{walking}-v0"


def write(config: DatasetConfig) -> pathlib.Path:
    """Writes a dataset, or goes on with one that was begun.

    Returns:
      Its folder.

    Raises:
      base.UserError: an option isn't as it should be, or the dataset is there already.
      base.Stopped: Ctrl-C was pressed; its text says what was kept.
    """
    name = name_of(config)
    minari_files.check_name(name)
    final = minari_files.folder_of(name, config.out)
    if final.exists():
        raise base.UserError(f"dataset {name!r} is there already, in {final}; give another --name")

    made = making.make(config)
    work = final.with_name(f".{final.name}.unfinished")
    with run_folder.RunFolder.create(
        work, config, resume=config.resume, may_change=("episodes", "out")
    ):
        finished = _run(config, made, work / _PARTS)
        # Put together apart, for it may be killed as well.
        staging = work / _STAGING
        writing.discard(staging)
        staging.mkdir()
        minari_files.write(
            name,
            staging,
            made.env,
            finished,
            config.seed,
            config.episodes,
            algorithm_name=f"{config.high}, {config.movement} movement",
            description=f"{config.robot} in {config.maze}, of eihrl_jax",
        )
        minari_files.make_namespace(name, config.out)
        (staging / name).rename(final)
    writing.discard(work)
    return final


def _run(config: DatasetConfig, made: making.Made, folder: pathlib.Path) -> list[pathlib.Path]:
    """Runs what is missing; returns the files of all parts in their order."""
    folder.mkdir(exist_ok=True)
    starts = range(0, config.episodes, config.batch)
    paths = [folder / f"{start:07d}.npz" for start in starts]
    done = sum(path.is_file() for path in paths)
    rows = parts.Rows(made.recorder, config.batch)

    name, total = name_of(config), config.episodes
    done = min(done * config.batch, total)
    with progress_lib.Progress(name, total, unit="episodes", done=done) as progress:
        progress.print(f"{name}: {total:,} episodes; Ctrl-C keeps what is there")
        try:
            for start, path in zip(starts, paths, strict=True):
                if not path.is_file():
                    parts.write(path, rows.run(config.seed + start), config.seed + start)
                    progress.update(min(start + config.batch, total))
        except KeyboardInterrupt:
            done = sum(path.is_file() for path in paths) * config.batch
            kept = f"{min(done, total):,} of {total:,} episodes"
            raise base.Stopped(f"{folder.parent} keeps {kept}") from None
    return paths
