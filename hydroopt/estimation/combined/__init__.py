"""Geometry, bodies and friction together, from the same recording."""
