"""Measurements of the figures in docs/benchmarks.md, one module per subject."""
