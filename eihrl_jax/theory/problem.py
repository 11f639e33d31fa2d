"""An MDP with a flat policy and a hierarchy: what the theory compares."""

import numpy as np
from flax import struct
from jaxtyping import Float

from eihrl_jax.theory import arguments


class Problem(struct.PyTreeNode):
    """An MDP with a flat policy and a hierarchy; float64, perhaps with leading axes for many.

    Attributes:
      transition: [S, A, S], probability of the next state.
      reward: [S, A], expected reward.
      flat: [S, A], the flat policy.
      low: [G, S, A], the low level under each subgoal.
      high: [S, G], probability of each subgoal.
    """

    transition: Float[np.ndarray, "*N S A S"]
    reward: Float[np.ndarray, "*N S A"]
    flat: Float[np.ndarray, "*N S A"]
    low: Float[np.ndarray, "*N G S A"]
    high: Float[np.ndarray, "*N S G"]

    def checked(self) -> "Problem":
        """Returns the problem in float64 after checking that its arrays fit together.

        Raises:
          ValueError: an array has a wrong shape, or rows that don't sum to 1.
        """
        # The transition says how many states and actions all the others must have.
        transition = arguments.transition(self.transition)
        sizes = transition.shape[-3:-1]
        low = arguments.probabilities("low", self.low, (None, *sizes))
        return Problem(
            transition=transition,
            reward=arguments.table("reward", self.reward, sizes),
            flat=arguments.probabilities("flat", self.flat, sizes),
            low=low,
            high=arguments.probabilities("high", self.high, (sizes[0], low.shape[-3])),
        )
