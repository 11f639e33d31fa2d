"""Evaluation, statistics, tables and pictures."""
