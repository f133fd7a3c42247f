"""The machine in equations: kinematics, regressor and inverse dynamics as CasADi functions."""
