"""Symmetries of a robot's body: ways to rename its parts that leave its physics as they are."""

import dataclasses
import functools
import itertools
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int

from eihrl_jax import base
from eihrl_jax.config import limits

SignedOrder = tuple[int, ...]
"""A signed permutation, counted from 1: entry i says which value moves to place i, and a negative
one that its sign changes on the way."""


@limits.dataclass
class Symmetry:
    """Turns about the body's z axis, and the mirror at its x-z plane, that map it to itself.

    A test checks each robot's against its physics: renaming and stepping commute.

    Attributes:
      num_turns: 4 for a body that is the same after quarter turns, 2 for half turns, else 1.
      turn_joints: joints after one turn by 360 / num_turns degrees: at place i stands the joint
        that is found where joint i was before the body's axes turned on.
      turn_controls: controls after the same turn.
      mirror_joints: joints after reflection; None: left and right are not alike.
      mirror_controls: controls after reflection.
    """

    num_turns: Annotated[int, limits.Range(1, 64)] = 1
    turn_joints: SignedOrder = ()
    turn_controls: SignedOrder = ()
    mirror_joints: SignedOrder | None = None
    mirror_controls: SignedOrder | None = None

    def __post_init__(self) -> None:
        """Checks that the orders are signed permutations of a group; they may come from a file."""
        for field in dataclasses.fields(self):
            order = getattr(self, field.name)
            is_order = isinstance(order, tuple)
            if is_order and sorted(map(abs, order)) != list(range(1, len(order) + 1)):
                raise base.UserError(
                    f"{field.name} = {order} must hold each of 1 to {len(order)} once, either sign"
                )

        if (self.mirror_joints is None) != (self.mirror_controls is None):
            raise base.UserError("mirror_joints and mirror_controls go together")
        _check_group("joints", self.num_turns, self.turn_joints, self.mirror_joints)
        _check_group("controls", self.num_turns, self.turn_controls, self.mirror_controls)

    @property
    def has_mirror(self) -> bool:
        """Whether the body equals its reflection."""
        return self.mirror_joints is not None

    def size(self, what: str) -> int:
        """Returns the number of "joints" or "controls" that are renamed."""
        return len(getattr(self, f"turn_{what}") or getattr(self, f"mirror_{what}") or ())

    def joint_tables(self) -> tuple[Int[np.ndarray, "V J"], Float[np.ndarray, "V J"]]:
        """Returns order and signs of the joints in each variant, see `tables`."""
        return tables(self.num_turns, self.turn_joints, self.mirror_joints)

    def control_tables(self) -> tuple[Int[np.ndarray, "V A"], Float[np.ndarray, "V A"]]:
        """Returns order and signs of the controls in each variant, see `tables`."""
        return tables(self.num_turns, self.turn_controls, self.mirror_controls)


def _check_group(what: str, num_turns: int, turn: SignedOrder, mirror: SignedOrder | None) -> None:
    """Checks that all turns and two reflections lead back, and that the two fit together.

    Raises:
      base.UserError: they don't.
    """
    if num_turns == 1 and turn:
        raise base.UserError(f"turn_{what} = {turn} needs num_turns above 1")
    if num_turns > 1 and mirror is not None and len(turn) != len(mirror):
        raise base.UserError(f"turn_{what} and mirror_{what} differ in length")

    identity = np.arange(1, len(turn or mirror or ()) + 1)

    def leads_back(*orders: SignedOrder) -> bool:
        return np.array_equal(functools.reduce(compose, orders, identity), identity)

    # Renaming a part and renaming it back must agree, or a variant would have two meanings.
    if num_turns > 1 and not leads_back(*[turn] * num_turns):
        raise base.UserError(f"turn_{what} = {turn}: {num_turns} turns aren't the identity")
    if mirror is not None and not leads_back(mirror, mirror):
        raise base.UserError(f"mirror_{what} = {mirror}: two reflections aren't the identity")

    # The relation of a dihedral group: a turn between two reflections is the turn back.
    if num_turns > 1 and mirror is not None and not leads_back(mirror, turn, mirror, turn):
        raise base.UserError(
            f"mirror_{what} = {mirror} doesn't fit turn_{what} = {turn}: mirrored, a turn must be "
            "a turn back"
        )


def tables(
    num_turns: int, turn: SignedOrder, mirror: SignedOrder | None
) -> tuple[Int[np.ndarray, "V J"], Float[np.ndarray, "V J"]]:
    """Lists the signed permutations of all V variants: variant n + num_turns * m.

    n counts turns, after which the body is mirrored where m is 1.

    Returns:
      `order` and `signs`, with which renaming is `signs[v] * values[order[v]]`.

    >>> order, signs = tables(2, (2, 1), (-1, -2))
    >>> (signs * order).tolist()
    [[0.0, 1.0], [1.0, 0.0], [-0.0, -1.0], [-1.0, -0.0]]
    """
    # Every variant's numbers from 1 on, as in `SignedOrder`; a mirror follows the turns.
    identity = np.arange(1, len(turn or mirror or ()) + 1)
    turned = list(itertools.accumulate([turn] * (num_turns - 1), compose, initial=identity))
    variants = turned + ([compose(old, mirror) for old in turned] if mirror is not None else [])
    signed = np.stack(variants)
    return np.abs(signed) - 1, np.sign(signed).astype(np.float32)


def compose(first: np.ndarray, then: SignedOrder) -> np.ndarray:
    """Returns the signed permutation that does `first` and then `then`.

    >>> compose(np.array([2, -1]), (-2, 1)).tolist()
    [1, 2]
    """
    second = np.asarray(then, np.int64)
    return np.sign(second) * first[np.abs(second) - 1]


def inverse(
    order: Int[np.ndarray, "V J"], signs: Float[np.ndarray, "V J"]
) -> tuple[Int[np.ndarray, "V J"], Float[np.ndarray, "V J"]]:
    """Returns the tables that undo the given ones."""
    back = np.argsort(order, axis=1)  # which inverts a permutation
    return back, np.take_along_axis(signs, back, axis=1)
