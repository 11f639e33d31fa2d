"""What the figures of docs/benchmarks.md are measured with, one module per subject."""
