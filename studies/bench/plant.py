"""Simulation of the machine on its valves: CVODES by exact derivatives against SciPy's BDF without them."""

import time

import numpy as np
from scipy.integrate import solve_ivp

from hydroopt import Model, load_machine
from hydroopt.model.plant import Plant

SAMPLES, STEP = 200, 0.01


def plant() -> None:
    """2 s of the CAT 215B, its valves moving every 10 ms: CVODES with CasADi's derivatives against SciPy's BDF."""
    subject = Plant(Model(load_machine("cat215b")))
    psi, theta, scale = subject.model.parameters.nominal, subject.parameters.nominal, subject.scale
    at = subject.steady(np.array([0.0, -0.5, 1.4]), np.zeros(3), psi, theta)
    commands = at.u + 0.1 * np.sin(np.outer(2 * np.pi * STEP * np.arange(SAMPLES), [0.5, 0.7, 1.1]))
    supply = subject.supply
    step = subject.integrator(STEP, psi, theta)
    began = time.perf_counter()
    ours = at.x
    for u in commands:
        ours = np.asarray(step(ours, u, supply)).ravel()
    seconds = time.perf_counter() - began
    began = time.perf_counter()
    theirs = at.x / scale
    for u in commands:
        def rates(_: float, z: np.ndarray, u: np.ndarray = u) -> np.ndarray:
            return np.asarray(subject.rates(z * scale, u, supply, psi, theta)).ravel() / scale

        theirs = solve_ivp(rates, (0.0, STEP), theirs, method="BDF", rtol=1e-7, atol=1e-9).y[:, -1]
    baseline = time.perf_counter() - began
    gap = np.max(np.abs(ours / scale - theirs))
    print(f"  CVODES {1e3 * seconds / SAMPLES:.2f} ms a sample, SciPy {1e3 * baseline / SAMPLES:.2f} ms, "
          f"ratio {baseline / seconds:.1f}; largest difference of scaled states at the end {gap:.1e}")
