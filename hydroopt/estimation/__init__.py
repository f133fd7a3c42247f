"""From experiments and priors to parameters: compression, solvers, intervals and what to think of them."""
