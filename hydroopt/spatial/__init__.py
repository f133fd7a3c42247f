"""Poses, twists and spatial inertia; the one order of inertial parameters."""
