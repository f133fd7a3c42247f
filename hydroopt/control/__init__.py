"""Closed-loop control: linear models, controllers, and their comparison in simulation."""
