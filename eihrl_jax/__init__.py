"""Hierarchical reinforcement learning for robots that find their way, end to end in JAX."""

__version__ = "0.1.0"
