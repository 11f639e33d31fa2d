"""HIGL, and HRAC and HIRO, from which it grew: a manager names displacements, a controller walks.

Kim et al. 2021, Landmark-guided subgoal generation in hierarchical reinforcement learning; Zhang et
al. 2020 (adjacency); Nachum et al. 2018 (off-policy correction).
"""
