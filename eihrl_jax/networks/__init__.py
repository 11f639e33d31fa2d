"""Flax modules of the two levels."""
