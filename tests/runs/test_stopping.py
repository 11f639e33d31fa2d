import gc
import sys
import time

import pytest

from eihrl_jax.runs import stopping


def test_ctrl_c_in_a_callback_of_the_collector_interrupts(monkeypatch, capfd):
    def interrupted(phase, info):
        gc.callbacks.remove(interrupted)
        raise KeyboardInterrupt

    monkeypatch.setattr(sys, "unraisablehook", sys.__unraisablehook__)
    stopping.not_lost()
    gc.callbacks.append(interrupted)
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        gc.collect()
        time.sleep(20.0)
    assert time.monotonic() - began < 10.0
    assert not capfd.readouterr().err


def test_other_exceptions_that_are_ignored_are_told(monkeypatch, capfd):
    class Broken:
        def __del__(self):
            raise ValueError("of a finaliser")

    monkeypatch.setattr(sys, "unraisablehook", sys.__unraisablehook__)
    stopping.not_lost()
    Broken()
    gc.collect()
    assert "of a finaliser" in capfd.readouterr().err
