"""What the documents say holds: examples run, commands are understood, links lead somewhere."""

import dataclasses
import doctest
import importlib
import pathlib
import re
import shlex

import pytest
import yaml

from eihrl_jax.cli import commands, shell

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
PICTURES = sorted((ROOT / "docs" / "images").iterdir())
MAX_PICTURE_BYTES = 600_000
MAX_README_WORDS = 900

TRAINING = (
    "eihrl_jax.reporting.evaluations",
    "eihrl_jax.reporting.trainers",
    "eihrl_jax.training.high",
    "eihrl_jax.training.low",
)
"""Examples that train or evaluate compile for half a minute what other tests compile otherwise."""

every_document = pytest.mark.parametrize("name", DOCUMENTS)


def anchors(path: pathlib.Path) -> set[str]:
    """What the headings of a document are linked by."""
    titles = re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def commands_in(text: str) -> set[str]:
    """Every command of this package in a document, in a block or within a line."""
    # Of `{droq,higl}` the first one stands for all.
    text = re.sub(r"\{(\w+),[^}]*\}", r"\1", text.replace("$seed", "0"))
    blocks = re.findall(r"^```(?:bash|console|text)\n(.*?)^```", text, re.M | re.S)
    inline = re.findall(r"`([^`\n]*)`", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S))
    lines = re.split(r"[\n;]", "\n".join([*blocks, *inline]))
    found = [
        re.search(r"^(?:\$ | do )?((?:python -m experiments\.|eihrl )\w.*)", line) for line in lines
    ]
    return {match[1] for match in found if match and "…" not in match[1]}


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in TRAINING)) for name in MODULES],
)
def test_examples_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert results.attempted > 0
    assert results.failed == 0


@pytest.mark.parametrize("name", [name for name in DOCUMENTS if name != "CHANGELOG.md"])
def test_commands_are_understood(name, capsys, monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "unused")
    for line in commands_in((ROOT / name).read_text()):
        _, *words = shlex.split(line.replace("python -m experiments.", "eihrl "), comments=True)
        command, *arguments = words or [""]
        command = command.replace("-", "_")
        assert command in commands.COMMANDS, f"{name}: {line}"
        # Named alone a command may lack what it is called with.
        if arguments:
            parsed_only = dataclasses.replace(
                commands.COMMANDS[command](), main=lambda _: None, uses_all_cores=False
            )
            try:
                shell.run(parsed_only, arguments, command)
            except SystemExit:
                pytest.fail(f"{name}: {line}: {capsys.readouterr().err}")


@every_document
def test_links_lead_somewhere(name):
    for target, anchor in re.findall(
        r"\]\(([^)#\s]*)(?:#([^)\s]*))?[^)]*\)", (ROOT / name).read_text()
    ):
        if target.startswith(("http://", "https://", "mailto:")):
            continue
        path = (ROOT / name).parent / target if target else ROOT / name
        assert path.exists(), f"{name}: {target} is not there"
        assert not anchor or anchor in anchors(path), f"{name}: {target} has no #{anchor}"


@every_document
def test_pictures_are_described(name):
    assert "![](" not in (ROOT / name).read_text()


@pytest.mark.parametrize("file", PICTURES, ids=lambda file: file.name)
def test_pictures_are_small_and_shown(file):
    assert file.stat().st_size < MAX_PICTURE_BYTES
    assert any(f"images/{file.name}" in (ROOT / name).read_text() for name in DOCUMENTS)


def test_the_first_screen_is_short():
    assert len((ROOT / "README.md").read_text().split()) <= MAX_README_WORDS


def test_every_page_is_in_the_navigation():
    site = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
    listed = re.findall(r"[\w/]+\.md", str(site["nav"]))
    pages = [path.relative_to(ROOT / "docs").as_posix() for path in ROOT.glob("docs/**/*.md")]
    assert sorted(listed) == sorted(pages)


@every_document
def test_make_targets_that_are_named_exist(name):
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = set(re.findall(r"(?:`|^\$ |^)make ([a-z-]+)(?:`|$| )", (ROOT / name).read_text(), re.M))
    assert named <= targets, f"{name}: {named - targets}"
