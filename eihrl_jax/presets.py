"""Named settings: `paper` as the paper has it, `best` for the highest numbers; never mixed."""

import dataclasses

from eihrl_jax.config import low as low_config


def low_paper() -> low_config.LowConfig:
    """The low level as in the paper: world frame, two-hot direction, eq. 1 alone.

    DroQ's numbers are those of its authors' code for the ant (Hiraoka et al. 2021); the paper names
    none. Alpha is 3 (Table 4).
    """
    return low_config.LowConfig(preset="paper")


def low_best() -> low_config.LowConfig:
    """The low level with all that keeps epsilon small in little time.

    Each stored step is looked at for a random direction, turned into that direction's frame; the
    robot knows how far it has come and how much time is left, is paid up to one cell and charged
    for drifting, and half of its rooms have inner walls. Many robots walk at once.
    """
    return low_config.LowConfig(
        preset="best",
        num_envs=64,
        num_iterations=45_000,
        warmup_iterations=200,
        updates_per_iteration=8,
        capacity=640_000,
        relabel=True,
        num_rooms=256,
        low_input=low_config.LowInput(frame="direction", use_progress=True),
        reward=low_config.LowReward(lateral_weight=0.5, stops_at_cell=True),
        droq=low_config.Droq(actor_period=2, temperature=0.1),
        log_every=50,
        evaluate_every=500,
        checkpoint_every=1_000,
    )


def low_point() -> low_config.LowConfig:
    """`best` for the point robot, which needs a few minutes on two cores."""
    return dataclasses.replace(
        low_best(),
        preset="point",
        robot="point",
        num_iterations=2_000,
        capacity=128_000,
        droq=low_config.Droq(hidden=(64, 64), actor_period=2, temperature=0.1),
    )


LOW = {"best": low_best(), "paper": low_paper(), "point": low_point()}
"""Presets of `train_low`, its default first."""
