"""Constraint forces for MJX: MuJoCo's Newton method, with a line search that costs a fifth.

MJX's own search evaluates three points at a time, eight times in every iteration, whatever the
robot needs. The cost along a line is convex and made of parabolas: Newton's method in one
dimension, kept between two ends, finds its minimum in a few points.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Bool, Float, Int
from mujoco import mjx


class _Problem(NamedTuple):
    """What is minimised over accelerations a: ½ (a - s)ᵀ M (a - s) + ½ Σ D (J a - r)² where active.

    Attributes:
      mass: float32 [nv, nv], M.
      smooth: float32 [nv], s, accelerations without constraints.
      smooth_force: float32 [nv], M s.
      jacobian: float32 [R, nv], J.
      target: float32 [R], r.
      stiffness: float32 [R], D.
      is_equality: bool [R], rows that are always active; others are where J a < r.
    """

    mass: Float[Array, "nv nv"]
    smooth: Float[Array, " nv"]
    smooth_force: Float[Array, " nv"]
    jacobian: Float[Array, "R nv"]
    target: Float[Array, " R"]
    stiffness: Float[Array, " R"]
    is_equality: Bool[Array, " R"]


class _Point(NamedTuple):
    """An iterate: accelerations, J a - r, M a, gradient, and iterations done."""

    qacc: Float[Array, " nv"]
    rest: Float[Array, " R"]
    force: Float[Array, " nv"]
    gradient: Float[Array, " nv"]
    iteration: Int[Array, ""]


def is_suited(model: mujoco.MjModel) -> bool:
    """Returns whether `solve` can replace MJX's solver: pyramidal friction, none in joints."""
    has_joint_friction = (model.dof_frictionloss > 0).any() or (model.tendon_frictionloss > 0).any()
    is_newton = model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
    is_pyramidal = model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    return bool(is_newton and is_pyramidal and not has_joint_friction)


def solve(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Returns `data` with accelerations under constraints, as `mjx.solve` does.

    Source: T. Erez, E. Todorov et al., MuJoCo documentation, "Computation: solver algorithms".
    """
    impl = data._impl
    problem = _Problem(
        mass=mjx.full_m(model, data),
        smooth=data.qacc_smooth,
        smooth_force=data.qfrc_smooth,
        jacobian=impl.efc_J,
        target=impl.efc_aref,
        stiffness=impl.efc_D,
        is_equality=jnp.arange(len(impl.efc_aref)) < impl.ne,
    )

    # The last step's accelerations, if they are better than those without constraints.
    warm, smooth = _start(problem, data.qacc_warmstart), _start(problem, data.qacc_smooth)
    is_warm = _cost(problem, warm) < _cost(problem, smooth)
    point = jax.tree.map(lambda a, b: jnp.where(is_warm, a, b), warm, smooth)

    tolerance = model.opt.tolerance * jnp.trace(problem.mass)

    def is_open(point: _Point) -> Bool[Array, ""]:
        is_steep = jnp.linalg.norm(point.gradient) > tolerance
        return (point.iteration < model.opt.iterations) & is_steep

    def iterate(point: _Point) -> _Point:
        return _iterate(problem, point, model.opt.ls_iterations)

    point = jax.lax.while_loop(is_open, iterate, point)
    pull = _active(problem, point.rest) * point.rest
    return data.replace(qacc=point.qacc, qfrc_constraint=-pull @ problem.jacobian)


def _start(problem: _Problem, qacc: Float[Array, " nv"]) -> _Point:
    rest, force = problem.jacobian @ qacc - problem.target, problem.mass @ qacc
    return _Point(qacc, rest, force, _gradient(problem, rest, force), jnp.int32(0))


def _active(problem: _Problem, rest: Float[Array, " R"]) -> Float[Array, " R"]:
    """Returns the stiffness of rows that are active, 0 of others."""
    return jnp.where((rest < 0.0) | problem.is_equality, problem.stiffness, 0.0)


def _cost(problem: _Problem, point: _Point) -> Float[Array, ""]:
    constraints = (_active(problem, point.rest) * jnp.square(point.rest)).sum()
    free = (point.force - problem.smooth_force) @ (point.qacc - problem.smooth)
    return 0.5 * (constraints + free)


def _gradient(
    problem: _Problem, rest: Float[Array, " R"], force: Float[Array, " nv"]
) -> Float[Array, " nv"]:
    pull = (_active(problem, rest) * rest) @ problem.jacobian
    return force - problem.smooth_force + pull


def _iterate(problem: _Problem, point: _Point, num_searched: int) -> _Point:
    """Goes along Newton's direction to where the cost is least."""
    weighted = _active(problem, point.rest)[:, None] * problem.jacobian
    hessian = problem.mass + problem.jacobian.T @ weighted
    factor = jax.scipy.linalg.cho_factor(hessian)
    direction = -jax.scipy.linalg.cho_solve(factor, point.gradient)

    rest_slope, force_slope = problem.jacobian @ direction, problem.mass @ direction
    free_slope = (point.force - problem.smooth_force) @ direction
    curvature = force_slope @ direction

    def slopes(step: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Returns first and second derivative of the cost along the line."""
        rest = point.rest + step * rest_slope
        pull = _active(problem, rest) * rest_slope
        return (pull @ rest + free_slope + step * curvature, pull @ rest_slope + curvature)

    def search(_: Int[Array, ""], ends: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        step, low, high = ends
        slope, bend = slopes(step)
        low, high = jnp.where(slope < 0.0, step, low), jnp.where(slope < 0.0, high, step)
        newton = step - slope / bend
        return jnp.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high)), low, high

    first, bend = slopes(jnp.float32(0.0))
    ends = -first / bend, jnp.float32(0.0), jnp.float32(jnp.inf)
    step = jax.lax.fori_loop(0, num_searched, search, ends)[0]
    # Rounding may make a direction point upwards where there is nothing left to gain.
    step = jnp.where(first < 0.0, step, 0.0)

    rest, force = point.rest + step * rest_slope, point.force + step * force_slope
    return _Point(
        qacc=point.qacc + step * direction,
        rest=rest,
        force=force,
        gradient=_gradient(problem, rest, force),
        iteration=point.iteration + 1,
    )
