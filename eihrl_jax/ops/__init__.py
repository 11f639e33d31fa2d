"""Numerical building blocks: returns, losses, geometry, statistics; arrays in, arrays out."""
