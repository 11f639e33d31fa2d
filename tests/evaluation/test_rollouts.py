"""Episodes of all rows at once: batches, smaller programs, recordings, where robots were."""

import dataclasses

import jax
import numpy as np
import pytest

from eihrl_jax import base, mazes, robots
from eihrl_jax.envs import raster, subgoals
from eihrl_jax.evaluation import lanes, loading, results, rollouts, streams
from eihrl_jax.reporting import evaluations
from eihrl_jax.runs import progress

CORRIDOR = "####\n#S1#\n####\n"


def random_walk(num_episodes, *, seeds=(0,), num_recorded=0, preview=None, text=None):
    """Returns the episodes of uniform directions, by default in the Random Square; no noise."""
    maze = mazes.parse(text, num_decisions=24) if text else mazes.load("random")
    chosen = {"random": maze}
    view = raster.View()
    robot = robots.load("point")
    gait = subgoals.gait(robot, None, 3.0, 0.0)
    env = loading.oracle_env(robot, mazes.stack(list(chosen.values())), view, gait=gait)
    plan = rollouts.Plan(
        mazes=chosen, seeds=seeds, num_episodes=num_episodes, num_recorded=num_recorded
    )
    high = loading.load_high("uniform")
    with progress.Progress("walk", plan.num_decisions) as bar:
        return rollouts.Runner(env, plan).run(high.policy, bar, preview)["random"]


def test_random_walk_succeeds_as_often_as_on_the_grid():
    # A uniform random walk from cell to cell finds the door within 24 moves 7.6 times in 100.
    episodes = random_walk(1500).episodes
    found = results.summarise(
        "random",
        results.Agent(robot="point", movement="oracle", high="uniform", low=None),
        episodes,
        num_goals=1,
        num_decisions=24,
    )
    assert found.success.low < 0.076 < found.success.high


@pytest.mark.parametrize("limit", ["MAX_ROWS", "MAX_BYTES"])
def test_batches_change_nothing(monkeypatch, limit):
    together = random_walk(6, seeds=(0, 1), num_recorded=2)
    monkeypatch.setattr(rollouts, limit, 5 if limit == "MAX_ROWS" else 60_000)
    apart = random_walk(6, seeds=(0, 1), num_recorded=2)
    for field in dataclasses.fields(results.Episodes):
        np.testing.assert_array_equal(
            getattr(together.episodes, field.name), getattr(apart.episodes, field.name)
        )
    np.testing.assert_array_equal(together.share, apart.share)
    assert len(together.recordings) == len(apart.recordings) == 2
    np.testing.assert_array_equal(together.recordings[1].qpos, apart.recordings[1].qpos)


def test_few_that_are_left_go_on_in_a_smaller_program(monkeypatch):
    options = {"seeds": (0, 1), "num_recorded": 3, "text": CORRIDOR}
    whole = random_walk(8, **options)
    monkeypatch.setattr(lanes, "MIN_DECISIONS", 1)
    monkeypatch.setattr(lanes, "SHARE", 4)
    sizes = []
    thinned = lanes.Lanes.thinned
    monkeypatch.setattr(
        lanes.Lanes, "thinned", lambda own: sizes.append(len(own.rows)) or thinned(own)
    )
    part = random_walk(8, **options)
    assert sizes == [16, 4]
    jax.tree.map(np.testing.assert_array_equal, whole.episodes, part.episodes)
    np.testing.assert_array_equal(whole.share, part.share)
    for one, other in zip(whole.recordings, part.recordings, strict=True):
        np.testing.assert_array_equal(one.qpos, other.qpos)


def test_recorded_episodes_can_be_seen_before_all_are_over():
    options = {"seeds": (0, 1), "num_recorded": 2}
    previews = []
    early = random_walk(6, **options, preview=previews.append)
    late = random_walk(6, **options)
    jax.tree.map(np.testing.assert_array_equal, early.episodes, late.episodes)
    np.testing.assert_array_equal(early.share, late.share)
    (preview,) = previews
    first = preview["random"]
    np.testing.assert_array_equal(first.episodes.decisions, late.episodes.decisions[:2])
    for one, other in zip(first.recordings, late.recordings, strict=True):
        np.testing.assert_array_equal(one.qpos, other.qpos)
    random_walk(3, num_recorded=2, preview=previews.append)  # most of them: nothing is gained
    assert len(previews) == 1


def test_no_more_is_recorded_than_memory_holds(monkeypatch):
    monkeypatch.setattr(rollouts, "MAX_BYTES", 1_000)
    rollout = random_walk(3, num_recorded=3)
    assert len(rollout.recordings) == 0 and len(rollout.episodes.achieved) == 3


def test_only_running_episodes_leave_traces():
    rollout = random_walk(40, num_recorded=40)
    count, ends = np.zeros(rollout.share.shape), []
    for recording, decisions in zip(rollout.recordings, rollout.episodes.decisions, strict=True):
        assert len(recording.direction) == len(recording.patch) == decisions
        assert len(recording.qpos) == 6 * decisions
        ends.append(recording.qpos[-1, :2])
        x, y = recording.qpos[:, :2].T
        bins = np.stack([-y, x]) / (base.CELL / 6)
        count[tuple(np.unique(np.floor(bins).astype(int), axis=1))] += 1
    np.testing.assert_allclose(rollout.share, count / 40)
    np.testing.assert_array_equal(rollout.episodes.end_xy, ends)
    typical = evaluations.typical(rollout)
    solved = rollout.episodes.achieved == 1
    if solved.any():
        assert len(typical.direction) in rollout.episodes.decisions[solved]


def test_a_maze_file_whose_name_is_no_text_has_streams():
    rows = np.array([[0, 0, 0], [0, 1, 0]])
    keys, _ = streams.streams(rows, ["b\udcffd.txt", "b\udcfed.txt"])
    first, second = jax.random.key_data(keys)
    assert not np.array_equal(first, second)
