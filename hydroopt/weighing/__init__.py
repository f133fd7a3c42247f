"""Weighing: the load that a machine carries while it moves."""
