"""The peers' learning curves: what they are drawn against."""

import numpy as np
import pytest

from eihrl_jax import base
from experiments import _report_peers

PEER = """step,success,episodes,eval/success,eval/reward
500,nan,0.0,,
1000,0.5,2.0,0.1,0.01
1500,0.5,4.0,,
2000,0.5,2.0,0.4,0.02
"""
OURS = """step,num_decisions,decisions,eval/success,eval/reward
20,1000.0,20.0,0.2,0.1
40,2000.0,10.0,,
60,3000.0,10.0,0.9,0.3
"""


@pytest.fixture
def folders(tmp_path):
    for name, text in (("peers/higl-u", PEER), ("peers/droq-u-dense", PEER), ("ours/best-u", OURS)):
        for seed in (0, 1):
            run = tmp_path / f"{name}-{seed}"
            run.mkdir(parents=True)
            (run / "metrics.csv").write_text(text)
    return tmp_path


def test_episodes_and_steps_are_counted_up_to_each_evaluation(folders):
    peer = folders / "peers" / "higl-u-0" / "metrics.csv"
    ours = folders / "ours" / "best-u-0" / "metrics.csv"
    for file, axis, expected in (
        (peer, "episodes", [[2.0, 0.1], [8.0, 0.4]]),
        (peer, "control steps", [[1000.0, 0.1], [2000.0, 0.4]]),
        (ours, "episodes", [[50.0, 0.2], [250.0, 0.9]]),
        (ours, "control steps", [[25e3, 0.2], [75e3, 0.9]]),
    ):
        found = _report_peers._AXES[axis](file, "eval/success")
        np.testing.assert_allclose(found, expected)


def ours(folders):
    """Finds our metrics as `_report_parts.Runs.metrics` does."""
    return lambda trained: sorted((folders / "ours").glob(f"{trained}-[0-9]*/metrics.csv"))


def test_every_task_that_a_peer_learned_has_its_pictures(folders):
    section = _report_peers.section(ours(folders), folders / "peers", folders / "out")
    assert [picture.path.name for picture in section.pictures] == [
        "peers-u-episodes.png",
        "peers-u-control-steps.png",
        "peers-u-dense-episodes.png",
        "peers-u-dense-control-steps.png",
    ]
    assert all(picture.path.stat().st_size > 10_000 for picture in section.pictures)


def test_a_folder_without_peers_is_named(folders):
    with pytest.raises(base.UserError, match="holds no <method>-<maze>-<seed>"):
        _report_peers.section(ours(folders), folders / "ours", folders / "out")
    assert not _report_peers.section(ours(folders), None, folders / "out").pictures
