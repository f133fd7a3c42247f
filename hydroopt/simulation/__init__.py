"""Simulated trajectories, logs, poses and driven valves."""
