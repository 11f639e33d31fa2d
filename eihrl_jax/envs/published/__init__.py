"""Tasks of other publications, for comparison with their figures."""
