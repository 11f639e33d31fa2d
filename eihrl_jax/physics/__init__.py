"""Rigid-body physics: one model, two engines, walls near the robot."""
