"""HESS: a manager explores a learned space of subgoals, a controller goes to them.

Li et al. 2021, Active hierarchical exploration with stable subgoal representation learning.
"""
