"""The baselines: flat DroQ, HIGL with HRAC and HIRO, and HESS, in the same mazes as ours."""
