"""Checkpoints come back as they were, completely or not at all."""

import gc
import json
import pathlib
import shutil
import signal

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from flax import struct

from eihrl_jax import base
from eihrl_jax.runs import checkpoint, stopping


class State(struct.PyTreeNode):
    params: dict
    opt_state: optax.OptState
    key: jax.Array
    keys: jax.Array
    is_done: jax.Array
    step: int


@pytest.fixture
def state():
    params = {"dense": {"kernel": jnp.arange(12.0).reshape(3, 4), "bias": jnp.zeros(4)}}
    return State(
        params=params,
        opt_state=optax.chain(optax.clip(1.0), optax.adam(1e-3)).init(params),
        key=jax.random.key(3),
        keys=jax.random.split(jax.random.key(4), 5),
        is_done=jnp.arange(4) > 1,
        step=7,
    )


def assert_equal(found, expected):
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for left, right in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert jnp.asarray(left).dtype == jnp.asarray(right).dtype
        if jnp.issubdtype(jnp.asarray(left).dtype, jax.dtypes.prng_key):
            left, right = jax.random.key_data(left), jax.random.key_data(right)
        np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("name", ["a [b]", "a\\b", "gs:", "no\udcffunicode"])
def test_any_name_of_a_folder_will_do(tmp_path, name):
    checkpoint.write(tmp_path / name / "c", {"w": np.arange(3.0)})
    np.testing.assert_array_equal(checkpoint.read(tmp_path / name / "c")["w"], np.arange(3.0))
    checkpoint.save(tmp_path / name / "run", 1, {"w": np.ones(2)})
    assert checkpoint.restore(tmp_path / name / "run", {"w": np.zeros(2)})[0] == 1


def test_state_comes_back_with_keys_optimiser_and_numbers(tmp_path, state):
    checkpoint.save(tmp_path, 7, state)
    step, found = checkpoint.restore(tmp_path, state)
    assert step == 7
    assert_equal(found, state)


def test_nothing_to_restore(tmp_path, state):
    assert checkpoint.restore(tmp_path / "absent", state) is None


def test_last_two_are_kept(tmp_path, state):
    for step in (9, 10, 11, 100):
        checkpoint.save(tmp_path, step, state.replace(step=step))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["000000000011", "000000000100"]
    assert checkpoint.restore(tmp_path, state)[1].step == 100


def test_saving_and_reading_keep_no_lists(tmp_path, state):
    def num_lists():
        gc.collect()
        return sum(isinstance(each, list) for each in gc.get_objects())

    counts = []
    for step in range(3):
        checkpoint.save(tmp_path, step, state)
        checkpoint.restore(tmp_path, state)
        counts.append(num_lists())
    assert counts[2] - counts[1] < 10


def test_saving_a_step_twice_changes_nothing(tmp_path, state):
    checkpoint.save(tmp_path, 1, state)
    checkpoint.save(tmp_path, 1, state.replace(step=8))
    assert checkpoint.restore(tmp_path, state)[1].step == 7


def test_leftovers_of_killed_save_are_ignored_and_removed(tmp_path, state):
    checkpoint.save(tmp_path, 1, state)
    half = tmp_path / ".incomplete-000000000002"
    shutil.copytree(tmp_path / "000000000001", half)
    (half / "manifest.json").unlink()
    assert checkpoint.restore(tmp_path, state)[0] == 1
    checkpoint.save(tmp_path, 1, state)
    assert not half.exists()
    checkpoint.save(tmp_path, 2, state)
    assert checkpoint.restore(tmp_path, state)[0] == 2


@pytest.fixture
def saved(tmp_path, state):
    return checkpoint.save(tmp_path, 1, state)


def largest_file(path: pathlib.Path) -> pathlib.Path:
    return max((path / "arrays").rglob("*"), key=lambda file: file.stat().st_size * file.is_file())


def test_truncated_file_is_named(saved, state):
    file = largest_file(saved)
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(base.UserError, match=f"is damaged: .*{file.name} has sha256"):
        checkpoint.restore(saved.parent, state)


def test_changed_byte_is_found(saved, state):
    file = largest_file(saved)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    with pytest.raises(base.UserError, match="is damaged"):
        checkpoint.restore(saved.parent, state)


def test_missing_and_additional_files_are_found(saved, state):
    (saved / "arrays" / "extra").write_text("x")
    with pytest.raises(base.UserError, match="arrays/extra is not in manifest"):
        checkpoint.restore(saved.parent, state)
    shutil.rmtree(saved / "arrays")
    with pytest.raises(base.UserError, match="is missing"):
        checkpoint.restore(saved.parent, state)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"format": 1, "files": 3, "arrays": {}}'])
def test_damaged_manifest(saved, state, text):
    (saved / "manifest.json").write_text(text)
    with pytest.raises(base.UserError, match=r"manifest.json can't be read"):
        checkpoint.restore(saved.parent, state)


def test_manifest_of_another_format(saved, state):
    manifest = json.loads((saved / "manifest.json").read_text())
    (saved / "manifest.json").write_text(json.dumps({**manifest, "format": 99}))
    with pytest.raises(base.UserError, match="format 99, expected 1"):
        checkpoint.restore(saved.parent, state)


def test_a_damaged_last_checkpoint_tells_which_one_is_left(tmp_path, state):
    for step in (1, 2):
        checkpoint.save(tmp_path, step, state)
    (tmp_path / f"{2:012d}" / "manifest.json").write_text("{")
    with pytest.raises(base.UserError, match=r"damaged.* the run goes on from step 1"):
        checkpoint.restore(tmp_path, state)
    assert checkpoint.last_step(tmp_path) == 2


def test_another_network_size_is_named(saved, state):
    wider = {"dense": {"kernel": jnp.zeros((3, 8)), "bias": jnp.zeros(8)}}
    with pytest.raises(base.UserError, match=r"bias is float32\[4\], expected float32\[8\]"):
        checkpoint.restore(saved.parent, state.replace(params=wider))


def test_tree_comes_back_without_template(tmp_path, state):
    checkpoint.write(tmp_path / "tree", state.params)
    assert_equal(checkpoint.read(tmp_path / "tree"), state.params)


def test_learner_state_without_template_is_refused(saved):
    with pytest.raises(base.UserError, match="holds a learner's state"):
        checkpoint.read(saved)


def test_existing_tree_is_not_overwritten(saved, state):
    with pytest.raises(base.UserError, match="is not overwritten"):
        checkpoint.write(saved, state)


def test_placement_follows_the_template(tmp_path):
    mesh = jax.make_mesh((8,), ("devices",))
    sharding = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("devices"))
    state = {"x": jax.device_put(jnp.arange(16.0), sharding)}
    checkpoint.save(tmp_path, 1, state)
    found = checkpoint.restore(tmp_path, state)[1]
    assert found["x"].sharding == sharding
    assert_equal(found, state)


def test_ctrl_c_waits_until_arrays_are_written():
    done = []
    with pytest.raises(KeyboardInterrupt), stopping.held_back():
        signal.raise_signal(signal.SIGINT)
        done.append("written")
    assert done == ["written"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
