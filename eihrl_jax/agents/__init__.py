"""Learners and the two-level agent as pure functions of their state."""
