import jax
import jax.numpy as jnp
import pytest

from eihrl_jax.envs.published import forward_run
from tests.envs.sled import Sled

GO, BREAK = jnp.zeros(8).at[0].set(0.5), jnp.zeros(8).at[3].set(1.0)


@pytest.fixture(scope="module")
def run():
    """Reset and step of episodes of two control steps, each compiled once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forward_run, "EPISODE_STEPS", 2)
        env = forward_run.ForwardRun(Sled())
        yield jax.jit(env.reset)(jax.random.key(0)), jax.jit(env.step)


def test_speed_pays_and_controls_cost(run):
    state, step = run
    assert state.inner.physics.qpos[3:7].tolist() == [1.0, 0.0, 0.0, 0.0]
    state = step(state, GO)
    # Half of a fifth of a cell in 0.1 s is 3 units per second.
    assert state.reward == pytest.approx(3.0 + 1.0 - 0.5 * 0.25, rel=1e-4)
    assert state.metrics["return"] == state.reward and state.metrics["steps"] == 1.0
    assert not (state.terminated | state.truncated)


def test_an_episode_ends_by_time_or_for_good_and_then_rests(run):
    state, step = run
    late = step(step(state, GO), GO)
    assert late.truncated and not late.terminated
    rested = step(late, GO)
    assert rested.reward == 0.0 and rested.metrics == late.metrics
    broken = step(state, BREAK)
    assert broken.terminated and not broken.truncated
    assert jnp.isfinite(broken.obs.proprioception).all()
    low = state.inner.replace(
        physics=state.inner.physics.replace(qpos=state.inner.physics.qpos.at[2].set(0.1))
    )
    assert step(state.replace(inner=low), GO).terminated
