"""Mazes as text, as pytrees, and as random rooms."""
