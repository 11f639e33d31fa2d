"""Bounds on what a hierarchy may lose: formulas (`bounds`) and exact checks on small MDPs."""
