"""The folder of one training run: what was run, with what, how it went, and how to go on.

    config.json     the options of the last start, as `codec.to_json` writes them
    sources/        its maze and what else options name, see `sources`
    versions.json   one entry per start: packages, Python, machine, commit, and how far it came
    metrics.csv     one row per `log`, one column per metric, see `metrics_log`
    tensorboard/    the same numbers as events
    checkpoints/    see `checkpoint`

A run killed at any moment goes on from its last checkpoint with nothing to clean up by hand, and
its metrics.csv then has the rows that the uninterrupted run would have.
"""

import json
import os
import pathlib
import sys
import time
from collections.abc import Collection, Mapping
from typing import Any, SupportsFloat, TypeAlias, TypeVar

import jax
from jaxtyping import PyTree

from eihrl_jax import base
from eihrl_jax.config import codec
from eihrl_jax.runs import checkpoint, folders, metrics_log, versions
from eihrl_jax.runs import sources as sources_lib
from eihrl_jax.storage import reading, writing

CHECKPOINTS = "checkpoints"
"""Name of the folder of a run's checkpoints."""

_CONFIG = "config.json"
_STARTS = "versions.json"

StateT = TypeVar("StateT")
Json: TypeAlias = Any  # What `json.loads` returns.


class RunFolder:
    """A run folder that this process alone writes to; made by `create`, closed by `with`.

    Attributes:
      path: the folder.
    """

    def __init__(self, path: pathlib.Path, lock: int | None):
        """Use `create`. Without lock, another process of the same run looks after the folder."""
        self.path = path
        self._lock = lock
        self._begin = time.monotonic()
        self._config = ""
        self._sources: sources_lib.Sources = {}
        self._starts: list[dict[str, Json]] = []
        self._metrics = metrics_log.MetricsLog(path)

    @classmethod
    def create(
        cls,
        path: pathlib.Path,
        options: object,
        *,
        resume: bool = False,
        may_change: Collection[str] = (),
        sources: sources_lib.Sources | None = None,
    ) -> "RunFolder":
        """Starts a run in a new folder, or goes on in an old one.

        Args:
          path: the folder.
          options: the run's config, a dataclass.
          resume: go on if the folder holds a run; a folder that is absent or empty is started.
          may_change: options that may differ from the run's first start, besides the two that tell
            where the run is and that it goes on.
          sources: files that options name; in a run that goes on, these are compared in place of
            their names.

        Raises:
          UserError: the folder holds something and `resume` is false; it holds no run, or one with
            other options or files; another process is writing to it.
        """
        if jax.process_index() != 0:
            return cls(path, None)  # The first process looks after the folder for all.
        is_taken = folders.check_free(path, resume=resume)
        if is_taken and not (path / _CONFIG).is_file():
            raise base.UserError(f"{path} holds no run to resume: it has no {_CONFIG}")
        text = codec.to_json(options)
        if is_taken:  # before the lock: a refused start leaves no trace
            by_contents = sources_lib.kept(path, sources or {})
            free = {"run", "resume", *may_change, *by_contents}
            _check_same_options(path / _CONFIG, options, free)
            sources_lib.check(path, sources or {})

        # Nothing is written before everything has been checked.
        path.mkdir(parents=True, exist_ok=True)
        run = cls(path, folders.take_lock(path))
        if folders.check_free(path, resume=resume) != is_taken:
            run.close()
            raise base.UserError(f"{path} has just been filled by another process")
        run._config, run._sources = text, sources or {}
        run._starts = [*read_starts(path), versions.describe()]
        if not is_taken:
            run._write_start()
        return run

    def __enter__(self) -> "RunFolder":
        """Returns the run folder itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the files and gives the lock back."""
        self.close()

    def close(self) -> None:
        """Closes the files and gives the lock back; may be called twice."""
        self._metrics.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def save(self, step: int, state: PyTree) -> None:
        """Writes a checkpoint; call it after `log` of the same step."""
        checkpoint.save(self.path / CHECKPOINTS, step, state)
        if self._lock is not None:
            seconds = round(time.monotonic() - self._begin, 1)
            logged = {"metrics": self._metrics.checksum}
            self._starts[-1] |= {"step": step, "seconds": seconds} | logged
            self._write_starts()

    def restore(self, template: StateT) -> tuple[int, StateT] | None:
        """Reads the last checkpoint and drops the metrics that were logged after it.

        A run that goes on must call it before anything else: until then nothing of it is touched.

        Args:
          template: a state of the same structure, as a fresh start makes it.

        Returns:
          Its step and its state, or None at the beginning of a run.

        Raises:
          UserError: the checkpoint is damaged or holds another structure, or there was one that is
            gone.
        """
        restored = checkpoint.restore(self.path / CHECKPOINTS, template)
        if self._lock is not None:
            # A run that has had a checkpoint would else lose its metrics, and begin anew unasked.
            lost = [start["step"] for start in self._starts if "step" in start]
            if restored is None and lost:
                gone = (
                    f"{self.path / CHECKPOINTS} holds none, though there was one of step {lost[-1]}"
                )
                raise base.UserError(f"{gone}; put it back, or name another --run")

            if restored is None and (self.path / metrics_log.FILE).is_file():
                if len(self._starts) == 1:  # this one: nobody knows of the others any more
                    gone = f"but neither a checkpoint nor a readable {_STARTS}; put them back"
                    raise base.UserError(f"{self.path} has metrics, {gone}, or name another --run")
                print(f"{self.path} has no checkpoint yet: the run begins anew", file=sys.stderr)
            step = -1 if restored is None else restored[0]
            known = [start.get("metrics") for start in self._starts if start.get("step") == step]
            self._metrics.rewind(step, known[-1] if known else None)
            self._write_start()
        return restored

    def log(self, step: int, metrics: Mapping[str, SupportsFloat]) -> None:
        """Appends one row to the run's metrics, see `MetricsLog.log`."""
        if self._lock is not None:
            self._metrics.log(step, metrics)

    def _write_start(self) -> None:
        """Writes the options, the versions of this start, and what it is made of."""
        writing.write_text(self.path / _CONFIG, self._config)
        sources_lib.keep(self.path, self._sources)
        self._write_starts()

    def _write_starts(self) -> None:
        writing.write_text(self.path / _STARTS, json.dumps(self._starts, indent=2))


def _check_same_options(file: pathlib.Path, options: object, may_change: Collection[str]) -> None:
    """Checks a run's options; those that are newer than the run count as left at their defaults."""
    text = reading.read_text(file)
    stored = reading.parse_json(text, str(file))

    # Through the config where it can be read as one: a newer option then has its default, and a
    # value that was written in another way its present form.
    misfit, new = None, _flat(json.loads(codec.to_json(options)))
    try:
        stored = json.loads(codec.to_json(codec.from_json(type(options), text, source=str(file))))
    except base.UserError as error:
        misfit = error
    old = _flat(stored)

    # Of a run of another kind, an option of both says more than one that is unknown.
    for name in dict.fromkeys([*new, *old]):
        is_of_both = name in new and name in old
        if name not in may_change and new.get(name) != old.get(name) and (is_of_both or not misfit):
            started = f"{file.parent} was started with {name} = {old.get(name)!r}"
            raise base.UserError(f"{started} and can't go on with {new.get(name)!r}")
    if misfit:
        raise misfit


def _flat(options: Json, name: str = "") -> dict[str, Json]:
    """Lists options by name, nested ones as a.b."""
    if not isinstance(options, dict):
        return {name: options}
    parts = [_flat(value, f"{name}.{key}" if name else key) for key, value in options.items()]
    return {key: value for part in parts for key, value in part.items()}


def read_options(path: pathlib.Path) -> dict[str, Json]:
    """Returns the options of a run's last start by name, those of an inner config as a.b.

    Raises:
      UserError: the folder holds no run, or a damaged one.
    """
    file = path / _CONFIG
    if not file.is_file():
        raise base.UserError(f"{path} holds no run: it has no {_CONFIG}")
    return _flat(reading.read_json(file))


def read_starts(path: pathlib.Path) -> list[dict[str, Json]]:
    """Returns what is known of each start of a run, the first one first.

    An entry is as `versions.describe` has it, with the `step` of its last checkpoint and the
    `seconds` until then, compilation included, where one was written, and the checksum of the
    `metrics` up to it.
    """
    try:
        starts = reading.read_json(path / _STARTS)
    except (FileNotFoundError, base.UserError):
        return []
    # What is told here is for readers alone: a run goes on without it.
    return (
        [start for start in starts if isinstance(start, dict)] if isinstance(starts, list) else []
    )
