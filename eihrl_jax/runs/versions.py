"""What a run was made with: packages, Python, machine and commit; no host name and no path."""

import datetime
import importlib.metadata
import os
import pathlib
import platform
import subprocess
from typing import Any

import jax

from eihrl_jax.storage import reading

PACKAGES = (
    "eihrl_jax",
    "jax",
    "jaxlib",
    "mujoco",
    "mujoco-mjx",
    "flax",
    "optax",
    "orbax-checkpoint",
    "numpy",
)


def describe() -> dict[str, Any]:
    """Returns the versions of the packages that matter, the machine and the checkout's commit.

    Of XLA's flags in the environment, those that name a place are left out.
    """
    device = jax.devices()[0]
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "packages": {name: _version(name) for name in PACKAGES},
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "cpu": _cpu_model(),
        "device": device.device_kind,
        "num_devices": jax.device_count(),
        "xla_flags": [flag for flag in os.environ.get("XLA_FLAGS", "").split() if "/" not in flag],
        "commit": _commit(pathlib.Path(__file__).parents[2]),
    }


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _cpu_model() -> str:
    try:
        lines = reading.read_text(pathlib.Path("/proc/cpuinfo")).splitlines()
    except OSError:
        return platform.processor()
    # Not on every processor: ARM's have no such line.
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor()


def _commit(root: pathlib.Path) -> str | None:
    """Returns the commit of the checkout at `root`, `+changes` appended if files were edited."""
    # An installed package may lie inside another project's checkout, whose commit says nothing.
    if not (root / ".git").exists():
        return None
    try:
        commit = _git(root, "rev-parse", "HEAD")
        is_edited = bool(_git(root, "status", "--porcelain", "--untracked-files=no"))
    except (OSError, subprocess.CalledProcessError):
        return None
    return commit + "+changes" * is_edited


def _git(root: pathlib.Path, *arguments: str) -> str:
    # Without its lock, which it would leave behind if it were killed.
    command = ["git", "--no-optional-locks", "-C", str(root), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout.strip()
