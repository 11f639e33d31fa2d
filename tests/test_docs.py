"""Examples in docstrings run, and links between the documents lead somewhere."""

import doctest
import importlib
import pathlib
import re

import pytest

ROOT = pathlib.Path(__file__).parents[1]
MODULES = sorted(
    ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for file in (ROOT / "eihrl_jax").rglob("*.py")
    if ">>>" in file.read_text()
)
DOCUMENTS = sorted(
    path.relative_to(ROOT).as_posix()
    for pattern in ("*.md", "docs/**/*.md", "eihrl_jax/**/*.md")
    for path in ROOT.glob(pattern)
)


TRAINING = (
    "eihrl_jax.reporting.evaluations",
    "eihrl_jax.reporting.trainers",
    "eihrl_jax.training.high",
    "eihrl_jax.training.low",
)
"""Examples that train or evaluate compile for half a minute what other tests compile otherwise."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in TRAINING)) for name in MODULES],
)
def test_examples_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert results.attempted > 0
    assert results.failed == 0


@pytest.mark.parametrize("name", DOCUMENTS)
def test_links_lead_somewhere(name):
    text = (ROOT / name).read_text()
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        is_elsewhere = target.startswith(("http://", "https://", "mailto:"))
        assert is_elsewhere or (ROOT / name).parent.joinpath(target).exists(), (
            f"{name}: {target} is not there"
        )


@pytest.mark.parametrize("name", DOCUMENTS)
def test_make_targets_that_are_named_exist(name):
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = set(re.findall(r"`make ([a-z-]+)`", (ROOT / name).read_text()))
    assert named <= targets, f"{name}: {named - targets}"
