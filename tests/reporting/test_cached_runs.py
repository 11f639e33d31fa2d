"""Runs that several processes share: each is made once, and nobody waits before the end."""

import dataclasses

import pytest

from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import presets
from eihrl_jax.reporting import cached_runs
from eihrl_jax.runs import folders


def test_what_others_are_at_comes_last(monkeypatch, capsys):
    done, slept = [], []
    monkeypatch.setattr(cached_runs.time, "sleep", slept.append)

    def job(name, busy_for=0):
        looks = iter(range(busy_for))

        def do():
            if next(looks, None) is not None:
                raise folders.TakenError("another")
            done.append(name)

        return do

    cached_runs.share([job("a", busy_for=1), job("b"), job("c", busy_for=3)])
    assert done == ["b", "a", "c"]
    assert len(slept) == 1  # only where all that was left was another's
    assert capsys.readouterr().err.splitlines() == ["waiting for 1 of other processes"]


def test_a_run_that_another_process_is_at_is_left_alone(tmp_path):
    options = dataclasses.replace(presets.low_point(), run=tmp_path / "run", resume=True)
    trained = []
    with folders.locked(options.run), pytest.raises(folders.TakenError):
        cached_runs.finish(options, trained.append)
    assert not trained
    cached_runs.finish(options, trained.append)
    assert trained == [options]


def test_an_evaluation_that_another_process_makes_is_left_alone(tmp_path):
    options = evaluate_config.EvaluateConfig(out=tmp_path / "out")
    theirs = tmp_path / "out.incomplete" / "theirs"
    theirs.parent.mkdir()
    theirs.touch()
    with folders.locked(tmp_path / "out.lock"), pytest.raises(folders.TakenError):
        cached_runs.evaluated(options)
    assert theirs.exists()
