"""Training with a picture: each run draws its learning curve anew with every checkpoint."""

from eihrl_jax.config import baselines as baselines_config
from eihrl_jax.config import high as high_config
from eihrl_jax.config import low as low_config
from eihrl_jax.reporting import learning_curve
from eihrl_jax.training import baselines, high, low


def train_high(config: high_config.HighConfig) -> float:
    """Trains a high level, see `training.high.train`, and draws its learning curve.

    >>> learner = high_config.Learner(num_workers=2, num_updates=2)  # presets have thousands
    >>> task = high_config.Task(maze="u")
    >>> periods = dict.fromkeys(("log_every", "evaluate_every", "checkpoint_every"), 2)
    >>> config = high_config.HighConfig(task=task, learner=learner, num_eval_episodes=2, **periods)
    >>> seconds = train_high(config)
    u high level: compiling training ...
    >>> (config.run / "learning_curve.png").is_file()
    True
    """
    return high.train(config, watch=learning_curve.renew)


def train_low(config: low_config.LowConfig) -> None:
    """Trains a low level, see `training.low.train`, and draws its learning curve.

    >>> short = {"num_envs": 2, "num_iterations": 2, "warmup_iterations": 1, "num_postures": 4}
    >>> periods = dict.fromkeys(("log_every", "evaluate_every", "checkpoint_every"), 2)
    >>> config = low_config.LowConfig(robot="point", capacity=8, **short, **periods)
    >>> train_low(config)
    point low level: compiling training ...
    >>> (config.run / "policy").is_dir()
    True
    """
    low.train(config, watch=learning_curve.renew)


def train_baseline(config: baselines_config.BaselineConfig) -> None:
    """Trains a baseline, see `training.baselines.train`, and draws its learning curve."""
    baselines.train(config, watch=learning_curve.renew)
