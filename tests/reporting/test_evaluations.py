import csv
import dataclasses
import json
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from eihrl_jax import base, mazes, robots
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import body as body_lib
from eihrl_jax.envs import low_obs, subgoals
from eihrl_jax.evaluation import loading, results, rollouts, tables
from eihrl_jax.networks import droq, patch_actor_critic
from eihrl_jax.physics import engines
from eihrl_jax.reporting import evaluations
from eihrl_jax.runs import folders, policies, progress

CORRIDOR = "####\n#S1#\n####\n"
OWN_MAZE = "#####\n#S.1#\n#...#\n#2..#\n#####\n"
NETWORK = {"tile": 3, "tile_features": 2, "hidden": [4]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a tiny random policy of each level and a maze."""
    path = tmp_path_factory.mktemp("evaluate")
    (path / "own.txt").write_text(OWN_MAZE)
    network = patch_actor_critic.PatchActorCritic(tile=3, tile_features=2, hidden=(4,))
    params = network.init(jax.random.key(0), jnp.zeros((9, 9, 3), bool))
    view = {"extent": 9.0, "pixels": 9}
    policies.save(
        path / "high", kind="high", params=params, meta={"view": view, "network": NETWORK}
    )
    robot = robots.load("point")
    engine = engines.make(robot)
    physics = body_lib.draw_pose(engine, jnp.zeros(2), jax.random.key(0))
    obs = low_obs.observe(physics, jnp.zeros(2), jnp.int32(1), jnp.int32(0), robot)
    num_features = len(low_obs.features(obs, robot, low_config.LowInput()))
    actor = droq.Actor(engine.model.nu, (4,))
    params = actor.init(jax.random.key(1), jnp.zeros((1, num_features)))["params"]
    meta = {
        "robot": "point",
        "low_input": {"frame": "world", "use_progress": False},
        "hidden": [4],
        "num_features": num_features,
        "num_actions": engine.model.nu,
    }
    policies.save(path / "low", kind="low", params=params, meta=meta)
    policies.save(path / "wrong", kind="low", params=params, meta=meta | {"hidden": [5]})
    return path


@pytest.fixture(scope="module")
def options(folder):
    return evaluate_config.EvaluateConfig(
        mazes=("random", str(folder / "own.txt")),
        robot=("point",),
        high=(str(folder / "high"),),
        low=(str(folder / "low"),),
        episodes=4,
        seeds=(5, 6),
        num_decisions=3,
        out=folder / "out",
    )


@pytest.fixture(scope="module")
def evaluation(options):
    return evaluations.evaluate(options)


def test_every_agent_is_evaluated_in_every_maze(evaluation, folder):
    found = [(cell.maze, cell.agent.movement, cell.agent.high) for cell in evaluation.cells]
    high = str(folder / "high")
    assert found == [
        (maze, movement, high) for movement in ("oracle", "full") for maze in ("random", "own")
    ]
    for cell in evaluation.cells:
        assert cell.num_episodes == 8
        assert cell.seeds == (5, 6)
        assert cell.num_goals == (2 if cell.maze == "own" else 1)
        assert cell.num_decisions == 3
        assert cell.success.low <= cell.success.rate <= cell.success.high
        assert cell.decisions_mean <= 3


def test_files_tell_the_same(evaluation, options):
    assert results.load(options.out / "eval.json") == evaluation
    about = json.loads((options.out / "eval.json").read_text())["about"]
    assert about["config"]["episodes"] == 4
    with (options.out / "episodes.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8 * 4
    for cell in evaluation.cells:
        place = (cell.maze, cell.agent.movement)
        mine = [row for row in rows if (row["maze"], row["movement"]) == place]
        achieved = np.array([int(row["achieved"]) for row in mine])
        assert achieved.mean() / cell.num_goals == cell.success.rate
        assert achieved.max() <= cell.num_goals
        assert [float(row["return"]) for row in mine] == achieved.tolist()
        assert sum(cell.goal_rates) == pytest.approx(achieved.mean())
    assert "own" in (options.out / "tables.md").read_text()


def test_pictures_are_written(evaluation, options):
    del evaluation
    names = sorted(path.name for path in options.out.glob("*.png"))
    labels = ("point-full-high", "point-oracle-high")
    expected = [f"{label}-heatmaps.png" for label in labels]
    expected += [f"{label}-{maze}-heatmap.png" for label in labels for maze in ("own", "random")]
    expected += [f"{label}-ends.png" for label in labels]
    assert names == sorted(expected)
    (gif,) = options.out.glob("*.gif")
    with Image.open(gif) as image:
        assert image.n_frames > 10


def test_nothing_is_overwritten(evaluation, options):
    del evaluation
    before = {path: path.stat().st_mtime_ns for path in options.out.iterdir()}
    with pytest.raises(base.UserError, match="not empty"):
        evaluations.evaluate(options)
    assert {path: path.stat().st_mtime_ns for path in options.out.iterdir()} == before


def test_high_levels_that_differ_in_parameters_alone_are_compiled_once(folder, capsys):
    robot, chosen = robots.load("point"), {"u": mazes.load("u", num_decisions=2)}
    high = loading.load_high(str(folder / "high"))
    gait = subgoals.gait(robot, None, 3.0, 0.0)
    env = loading.oracle_env(robot, mazes.stack(list(chosen.values())), high.view, gait=gait)
    plan = rollouts.Plan(mazes=chosen, seeds=(0,), num_episodes=3, num_recorded=1)
    runner = rollouts.Runner(env, plan)

    def directions(policy):
        with progress.Progress("walk", plan.num_decisions) as bar:
            rollout = runner.run(policy, bar)["u"]
        return rollout.recordings[0].direction.tolist()

    (params,) = high.policy.args
    for direction in range(4):
        bias = params["params"]["logits"]["bias"].at[direction].set(1e6)
        layers = params["params"] | {"logits": params["params"]["logits"] | {"bias": bias}}
        policy = jax.tree_util.Partial(high.policy.func, {"params": layers})
        assert directions(policy) == [direction] * 2
    assert capsys.readouterr().out.count("walk: compiled episodes in") == 1
    directions(loading.load_high(str(folder / "high"), greedy=True).policy)
    assert capsys.readouterr().out.count("walk: compiled episodes in") == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"episodes": 0}, "episodes = 0"),
        ({"seeds": (-1,)}, "seeds = -1"),
        ({"seeds": (1, 1)}, "seeds names 1 more than once"),
        ({"mazes": ()}, "mazes is empty"),
        ({"movement": ("walking",)}, "movement = 'walking' must be one of oracle, full"),
        ({"engine": "ode"}, "engine = 'ode' must be one of mujoco, mjx"),
        ({"animate": "some"}, "animate = 'some' must be one of one, all, failed, none"),
        ({"num_decisions": 0}, "num_decisions = 0"),
        ({"reward": "fat"}, "reward = 'fat' must be one of sparse, dense"),
        ({"low": ("a", "b")}, "low names 2 policies for 1 robots"),
        ({"low": ("a",), "movement": ("oracle",)}, "low = a needs movement full"),
        ({"sigma": 0.2, "movement": ("full",)}, "sigma = 0.2 needs movement oracle"),
    ],
)
def test_options_out_of_range_are_refused(change, message):
    with pytest.raises(base.UserError, match=message):
        evaluate_config.EvaluateConfig(**change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mazes": ("nowhere",)}, "nowhere"),
        ({"robot": ("cat",), "low": ()}, "cat"),
        ({"high": ("no/such/run",)}, "no/such/run"),
        ({"low": ("no/such/run",)}, "no/such/run"),
        ({"sigma": -1.0}, "sigma = -1.0"),
    ],
)
def test_unknown_things_are_refused_before_anything_is_written(options, tmp_path, change, message):
    changed = dataclasses.replace(options, out=tmp_path / "out", **change)
    with pytest.raises(base.UserError, match=message):
        evaluations.evaluate(changed)
    assert not changed.out.exists()


@pytest.mark.parametrize(
    ("name", "mazes_", "same"),
    [("high", ["a"], "point-oracle-high,"), ("high-b", ["b-c", "c"], "point-oracle-high-b-c,")],
)
def test_agents_whose_files_would_have_the_same_name_are_refused(
    options, folder, tmp_path, name, mazes_, same
):
    shutil.copytree(folder / "high", tmp_path / "other" / name)
    both = (str(folder / "high"), str(tmp_path / "other" / name))
    files = [tmp_path / f"{maze}.txt" for maze in mazes_]
    for file in files:
        file.write_text(OWN_MAZE)
    changed = dataclasses.replace(
        options, out=tmp_path / "out", high=both, mazes=tuple(map(str, files))
    )
    with pytest.raises(base.UserError, match=f"the same name, {same}"):
        evaluations.evaluate(changed)


def test_names_are_text_and_numbers_need_no_picture(tmp_path, monkeypatch, capsys):
    names = ["cost$a_^b$", "maze[bold]|x", "x" * 240, "new\nline"]
    files = [tmp_path / f"{name}.txt" for name in names]
    for file in files:
        file.write_text(CORRIDOR)
    options = evaluate_config.EvaluateConfig(
        mazes=tuple(map(str, files)),
        robot=("point",),
        movement=("oracle",),
        high=("uniform",),
        episodes=1,
        seeds=(0,),
        num_decisions=1,
        animate="none",
        out=tmp_path / "out",
    )

    def fail(*_):
        raise MemoryError("the drawing\nis too large")

    monkeypatch.setattr(evaluations.heatmap, "save_together", fail)
    cells = evaluations.evaluate(options).cells
    assert [cell.maze for cell in cells] == names
    assert "drawn: the drawing\n" in capsys.readouterr().err
    assert results.load(options.out / "eval.json").cells == cells
    assert r"| maze[bold]\|x |" in (options.out / "tables.md").read_text()
    tables.show(tables.terminal(cells))
    shown = capsys.readouterr().out
    assert "maze[bold]|x " in shown and r"new\nline" in shown
    pictures = {path.name for path in options.out.glob("*-heatmap.png")}
    assert "point-oracle-uniform-cost$a_^b$-heatmap.png" in pictures and len(pictures) == 4


def test_an_evaluation_that_was_stopped_begins_anew_in_its_folder(options, tmp_path, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    oracle = {"movement": ("oracle",), "low": (), "episodes": 1, "animate": "none"}
    changed = dataclasses.replace(options, out=tmp_path / "out", **oracle)
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(evaluations.heatmap, "save", stop)
        evaluations.evaluate(changed)
    (cell, *_) = results.load(changed.out / "eval.json").cells  # numbers come first
    with pytest.raises(base.UserError, match="not empty"):
        evaluations.evaluate(dataclasses.replace(changed, episodes=2))
    assert evaluations.evaluate(changed).cells[0] == cell
    with pytest.raises(base.UserError, match="not empty"):
        evaluations.evaluate(changed)


def test_a_folder_is_filled_by_one_process_at_a_time(tmp_path):
    out = tmp_path / "deep" / "out"
    with folders.reserved(out):
        with pytest.raises(base.UserError, match="being written to by another process"):
            with folders.reserved(out):
                pass
    assert not out.exists()  # nothing was written
    with folders.reserved(out):
        (out / "eval.json").touch()
    assert [file.name for file in out.iterdir()] == ["eval.json"]
    with pytest.raises(base.UserError, match="not empty"):
        with folders.reserved(out):
            pass


def test_a_lock_that_was_removed_meanwhile_is_none(tmp_path, monkeypatch):
    (tmp_path / folders.LOCK).touch()
    flock = folders.fcntl.flock

    def locked_late(descriptor, how):
        (tmp_path / folders.LOCK).unlink()  # by the process that had it, which has just ended
        flock(descriptor, how)

    monkeypatch.setattr(folders.fcntl, "flock", locked_late)
    with pytest.raises(base.UserError, match="being written to by another process"):
        folders.take_lock(tmp_path)


def test_policies_that_do_not_fit_are_refused(folder):
    with pytest.raises(base.UserError, match="expected 'ant'"):
        loading.load_low(str(folder / "low"), robots.load("ant"))
    with pytest.raises(base.UserError, match=r"holds another network or state: .* expected"):
        loading.load_low(str(folder / "wrong"), robots.load("point"))
    with pytest.raises(base.UserError, match="expected a high-level"):
        loading.load_high(str(folder / "low"))


def test_a_first_look_at_what_fails(tmp_path):
    out = tmp_path / "look"
    options = evaluate_config.EvaluateConfig(
        mazes=("u",),
        robot=("point",),
        movement=("oracle",),
        high=("uniform",),
        quick=True,
        animate="failed",
        out=out,
    )
    (cell,) = evaluations.evaluate(options).cells
    assert (cell.agent.movement, cell.num_episodes) == ("oracle", 20)
    (picture,) = out.glob("*.gif")
    assert picture.name == "point-oracle-uniform-u-late.gif"
    assert not any(out.glob("*.png"))
