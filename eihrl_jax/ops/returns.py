"""Returns of one trajectory, from the last step backwards (paper, Algorithm 1, lines 12 to 14)."""

import jax
from jaxtyping import Array, Float


def lambda_returns(
    r_t: Float[Array, " T"],
    discount_t: Float[Array, " T"],
    v_t: Float[Array, " T"],
    lambda_t: Float[Array, " T"],
) -> Float[Array, " T"]:
    """Computes the lambda-return of each step of a trajectory.

    Args:
      r_t: reward that the step led to, unitless.
      discount_t: in [0, 1], gamma * (1 - terminated); never 0 for truncation.
      v_t: value of the state that the step led to (of `final_obs` where truncated).
      lambda_t: in [0, 1], weight of the return that follows over the value; 0 where the next
        entry belongs to another episode (a time limit), so that the value takes its place. The
        last one has no effect: nothing follows.

    Returns:
      G_t = r_t + discount_t * ((1 - lambda_t) * v_t + lambda_t * G_{t+1}), with v_t of the last
      step standing for the G_{t+1} that is missing.

    Source: Sutton and Barto, Reinforcement Learning (2018), Eq. 12.18, with state values.
    Differs from the paper (Algorithm 1, lines 12 to 14), whose returns are those of lambda_t = 1
      without a value: its R starts as the last reward and then takes that reward again in the
      first pass of the loop; here every reward counts once.
    """

    def step(following, inputs):
        # Paper: Algorithm 1, line 14, R <- r_t + gamma R, for a weight of 1.
        reward, discount, value, weight = inputs
        following = reward + discount * ((1.0 - weight) * value + weight * following)
        return following, following

    _, returns = jax.lax.scan(step, v_t[-1], (r_t, discount_t, v_t, lambda_t), reverse=True)
    return returns
