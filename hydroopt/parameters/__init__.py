"""Parameter vectors of a machine: names, units, nominal values, bounds and priors."""
