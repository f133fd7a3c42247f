"""Valves and oil from commands, pressures and motion."""
