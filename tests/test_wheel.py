"""The package as others get it: a wheel, in an environment and a folder without a checkout."""

import os
import pathlib
import subprocess
import sys
import sysconfig
import venv

import pytest

ROOT = pathlib.Path(__file__).parents[1]
PRETRAINED = ROOT / "eihrl_jax" / "pretrained"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A new environment that holds the wheel; its dependencies are those of this environment."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    build = ["wheel", "--no-deps", "--no-build-isolation", "--no-index", "-w", str(folder)]
    # From a copy: a build leaves folders beside its sources.
    sources = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split("\0")
    copy = folder / "sources"
    for name in sources:
        if name.startswith(("eihrl_jax/", "pyproject.toml", "README.md", "LICENSE")):
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            (copy / name).write_bytes((ROOT / name).read_bytes())
    subprocess.run([*pip, *build, str(copy)], check=True, capture_output=True)

    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "env", with_pip=False)
    python = folder / "env" / "bin" / "python"
    install = ["--python", str(python), "install", "--no-deps", "--no-index", str(wheel)]
    subprocess.run([*pip, *install], check=True, capture_output=True)
    (site,) = (folder / "env" / "lib").glob("python*/site-packages")
    # A line of a .pth file comes behind the environment's own packages.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    (folder / "elsewhere").mkdir()
    return folder


def run(installed, *words):
    """Runs a program of the environment in a folder outside of the checkout; returns its output."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment["XDG_CACHE_HOME"] = str(installed / "cache")
    done = subprocess.run(
        [installed / "env" / "bin" / words[0], *words[1:]],
        cwd=installed / "elsewhere",
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_shipped_file_is_in_the_wheel(installed):
    (site,) = (installed / "env" / "lib").glob("python*/site-packages")
    package = site / "eihrl_jax"
    for folder in ("pretrained", "robots/assets"):
        files = {
            path.relative_to(ROOT / "eihrl_jax")
            for path in (ROOT / "eihrl_jax" / folder).rglob("*")
        }
        assert len(files) > 5
        assert not {str(path) for path in files if not (package / path).exists()}


def test_the_package_is_used_without_a_checkout(installed):
    code = (
        "import eihrl_jax\n"
        "print(eihrl_jax.__file__)\n"
        "print(eihrl_jax.load_high('best-u-0').label, eihrl_jax.load_robot('ant').name)\n"
    )
    place, loaded = run(installed, "python", "-c", code).splitlines()
    assert pathlib.Path(place).is_relative_to(installed / "env")
    assert loaded == "best-u-0 ant"


def test_a_command_evaluates_a_shipped_policy(installed):
    words = ["evaluate", "--mazes", "u", "--high", "best-u-0", "--movement", "oracle"]
    quick = ["--episodes", "2", "--animate", "none", "--no-heatmaps", "--out", "here"]
    assert "written to here" in run(installed, "eihrl", *words, *quick)
    assert (installed / "elsewhere" / "here" / "eval.json").is_file()
