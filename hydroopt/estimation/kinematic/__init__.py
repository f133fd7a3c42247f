"""Geometry from poses of closed chains."""
