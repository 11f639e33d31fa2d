"""The benchmark: what is told of figures, and what is left of a measurement. Nothing is timed."""

import json
import pathlib

import jax.numpy as jnp
import pytest

from eihrl_jax import base
from eihrl_jax.benchmarks import suite, timing
from eihrl_jax.benchmarks.part import Part

ROOT = pathlib.Path(__file__).parents[2]
RECORDS = sorted((ROOT / "results" / "benchmarks").glob("*.json"))


def figures(file):
    return json.loads(file.read_text())["found"]


def test_the_page_tells_the_figures_on_record():
    table = suite.markdown(figures(ROOT / "results" / "benchmarks" / "physics.json"))
    assert table in (ROOT / "docs" / "benchmarks.md").read_text()


@pytest.mark.parametrize("file", RECORDS, ids=lambda file: file.stem)
def test_every_record_can_be_told(file):
    _, _, *rows = suite.markdown(figures(file)).splitlines()
    assert len(rows) >= len(figures(file))
    assert all(row.startswith("| ") and row.count(" | ") == 1 for row in rows)


def test_every_part_but_throughput_is_on_record():
    assert {part for file in RECORDS for part in figures(file)} == {*suite.PARTS} - {"throughput"}
    rows = suite.markdown({"throughput": [{"engine": "mjx", "num_envs": 1024, "rate": 54321.0}]})
    assert rows.splitlines()[2:] == ["| 1,024 ants at once, mjx | 54,321 control steps/s |"]


def test_figures_and_text_are_written(tmp_path, monkeypatch):
    part = Part(lambda: {"rate": 2.0}, lambda figures: {"things": f"{figures['rate']:.0f}/s"})
    monkeypatch.setitem(suite.PARTS, "speed", part)
    suite.main(suite.BenchmarkConfig(parts=("speed",), out=tmp_path / "new"))
    document = json.loads((tmp_path / "new" / "benchmark.json").read_text())
    assert document["found"] == {"speed": {"rate": 2.0}}
    assert "cpu" in document["machine"]
    text = (tmp_path / "new" / "benchmark.md").read_text()
    assert text == "| what | measured |\n|---|---|\n| things | 2/s |\n"
    with pytest.raises(base.UserError, match="exists already"):
        suite.main(suite.BenchmarkConfig(parts=("speed",), out=tmp_path / "new"))


def test_bad_parts_are_named():
    with pytest.raises(base.UserError, match=r"parts = 'sped' must be one of speed, "):
        suite.BenchmarkConfig(parts=("sped",))
    with pytest.raises(base.UserError, match="parts is empty"):
        suite.BenchmarkConfig(parts=())


def test_calls_go_on_from_the_last_state_and_are_timed():
    states = [int(state) for state, _ in timing.successive(lambda x: 2 * x, jnp.array(3), 3)]
    assert states == [6, 12, 24]
    roll = timing.rolled(lambda total, x: total + x, jnp.array(1.0), jnp.arange(4.0))
    assert float(roll()) == 7.0
    assert timing.shortest({"roll": roll}, 2)["roll"] > 0.0
