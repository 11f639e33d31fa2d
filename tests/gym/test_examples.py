"""The examples of the page on Gymnasium run, with little training, where their client is there."""

import importlib.util
import pathlib
import re

import pytest

from eihrl_jax.mazes import layouts

PAGE = (pathlib.Path(__file__).parents[2] / "docs" / "gymnasium.md").read_text()
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
CLIENTS = ("stable_baselines3", "sbx", "moviepy")


def lacks(example: str) -> list[str]:
    """Clients of an example that aren't installed; `RecordVideo` writes by way of moviepy."""
    text = example.replace("RecordVideo", "moviepy")
    return [name for name in CLIENTS if name in text and not importlib.util.find_spec(name)]


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
# SB3 wants its users to know that a GPU would be of no use.
@pytest.mark.filterwarnings("ignore:.*primarily intended to run on the CPU")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_examples_run(number, tmp_path, monkeypatch):
    example = EXAMPLES[number]
    if lacks(example):
        pytest.skip(f"{', '.join(lacks(example))} not installed")

    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_maze.txt").write_text(layouts.U)
    small = re.search(r"```text\n(#####\n.*?)```", PAGE, re.DOTALL)
    (tmp_path / "u5.txt").write_text(small[1])
    # Learners stop at the first occasion after one step, which comes soon.
    short = re.sub(r"\.learn\([\d_]+\)", ".learn(1)", example)
    short = re.sub(r"n_steps=\d+", "n_steps=16", short)
    assert short != example or "learn" not in example
    exec(compile(short, f"docs/gymnasium.md, example {number}", "exec"), {})
