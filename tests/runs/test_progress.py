"""Progress is visible, with success, speed and time left, wherever the output goes."""

import io

import pytest
import rich.console

from eihrl_jax.runs import progress


def console(file=None):
    return rich.console.Console(file=file or io.StringIO())


@pytest.fixture
def clock(monkeypatch):
    """Replaces the clock; `clock[0] = t` sets it."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_plain_lines_every_few_seconds(clock):
    file = io.StringIO()
    with progress.Progress("train", 1000, unit="decisions", console=console(file)) as bar:
        for second in range(1, 11):
            clock[0] = float(second)
            bar.update(10 * second, {"success": 0.5})
    lines = file.getvalue().splitlines()
    assert lines == [
        "train: 5 % | 50/1,000 decisions | success 50.0 % | 10 decisions/s | 1 min 35 s left",
        "train: 10 % | 100/1,000 decisions | success 50.0 % | 10 decisions/s | 1 min 30 s left",
    ]


def test_compiling_is_told_and_not_counted(clock):
    file = io.StringIO()
    with progress.Progress("train", 1000, console=console(file)) as bar:
        with bar.compiling("update"):
            clock[0] = 30.0
        clock[0] = 40.0
        bar.update(500)
        assert bar.steps_per_second == 50.0
    assert "compiled update in 30.0 s" in file.getvalue()


def test_resumed_steps_are_not_counted_as_speed(clock):
    with progress.Progress("train", 1000, done=900, console=console()) as bar:
        clock[0] = 10.0
        bar.update(950)
        assert bar.steps_per_second == 5.0


def test_bar_on_a_terminal(monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    file = io.StringIO()
    with progress.Progress("train", 10, console=console(file)) as bar:
        bar.update(10, {"success": 1.0})
    assert "success 100.0 %" in file.getvalue()


def test_unknown_metric_names_are_shown_as_numbers(clock):
    file = io.StringIO()
    with progress.Progress("train", 10, console=console(file)) as bar:
        bar.update(0, {"loss": 0.12345})
    assert "loss 0.123" in file.getvalue()
