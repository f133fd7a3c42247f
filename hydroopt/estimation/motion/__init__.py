"""The motion that all sensors together make most probable, with biases, mounting and geometry."""
