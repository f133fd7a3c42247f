"""Choosing measurements: poses, readings by hand, motions, and the calibrator to build."""
