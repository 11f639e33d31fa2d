"""The examples of the pages run, briefly, where their client is there."""

import importlib.util
import pathlib
import re

import jax
import pytest

from eihrl_jax.mazes import layouts

ROOT = pathlib.Path(__file__).parents[2]
NAMES = (
    "README",
    "docs/brax",
    "docs/gymnasium",
    "docs/start",
    "docs/theory",
    "docs/tutorials/own_learner",
)
PAGES = {name: (ROOT / f"{name}.md").read_text() for name in NAMES}
SLOW = ("ppo.train", "sac.train", "episode.save")
"""What compiles or draws for a minute."""

EXAMPLES = [
    pytest.param(
        name,
        text,
        marks=[pytest.mark.slow] * any(word in text for word in SLOW),
        id=f"{name.removeprefix('docs/')}-{i}",
    )
    for name, page in PAGES.items()
    for i, text in enumerate(re.findall(r"```python\n(.*?)```", page, re.DOTALL))
]
CLIENTS = ("brax", "stable_baselines3", "sbx", "moviepy")


def lacks(example: str) -> list[str]:
    """Clients of an example that aren't installed; `RecordVideo` writes by way of moviepy."""
    text = example.replace("RecordVideo", "moviepy")
    return [name for name in CLIENTS if name in text and not importlib.util.find_spec(name)]


@pytest.mark.parametrize(("name", "example"), EXAMPLES)
# SB3 wants its users to know that a GPU would be of no use.
@pytest.mark.filterwarnings("ignore:.*primarily intended to run on the CPU")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_examples_run(name, example, tmp_path, monkeypatch):
    if lacks(example):
        pytest.skip(f"{', '.join(lacks(example))} not installed")

    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_maze.txt").write_text(layouts.U)
    small = re.search(r"```text\n(#####\n.*?)```", PAGES["docs/gymnasium"], re.DOTALL)
    (tmp_path / "u5.txt").write_text(small[1])
    # Learners stop at the first occasion after one step, which comes soon.
    short = re.sub(r"\.learn\([\d_]+\)", ".learn(1)", example)
    short = re.sub(r"n_steps=\d+", "n_steps=16", short)
    short = re.sub(r"NUM_UPDATES, (.*) = [\d_]+", r"NUM_UPDATES, \1 = 2", short)
    short = re.sub(r"num_timesteps=[\d_]+", "num_timesteps=1", short)
    short = short.replace("num_envs=64", "num_envs=8").replace("=6_400", "=0")
    assert short != example or not re.search(r"\.learn\(|\.train\(|NUM_UPDATES", example)
    # Brax isn't as strict about types as the tests are.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        exec(compile(short, f"{name}.md", "exec"), {})
