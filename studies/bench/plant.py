"""Simulation of machines on their valves: compiled code, CVODES by exact derivatives, SciPy's BDF without them."""

import time
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from hydroopt import Model, load_machine
from hydroopt.machine.machine import Machine
from hydroopt.model.plant import Plant
from hydroopt.spatial.inertia import Array
from studies.bench.goals import Row

SAMPLES, STEP = 200, 0.02
THIN = 1e-3
"""Part of the line's volume between pump and valves that makes the machine stiff."""


def plant() -> list[Row]:
    """4 s of the CAT 215B, its valves moving every 20 ms; the same, stiff, with 10 mL between pump and valves."""
    machine = load_machine("cat215b")
    described = machine.model_dump()
    described["pump"]["volume"] *= THIN
    usual, _ = (_compare(name, Plant(Model(subject))) for name, subject in (
        ("CAT 215B", machine), ("stiff", Machine.model_validate(described))))
    return [Row("plant", usual[0], "CVODES", usual[1])]


def _compare(name: str, subject: Plant) -> list[float]:
    """How many times as fast as real time each way is, the compiled one first."""
    psi, theta = subject.model.parameters.nominal, subject.parameters.nominal
    scale, supply = subject.scale, subject.supply
    at = subject.steady(np.array([0.0, -0.5, 1.4]), np.zeros(3), psi, theta)
    commands = at.u + 0.1 * np.sin(np.outer(2 * np.pi * STEP * np.arange(SAMPLES), [0.5, 0.7, 1.1]))
    compiled, exact = (subject.integrator(psi, theta, tolerance=tolerance) for tolerance in (1e-7, 1e-11))
    cvodes = subject.integrator(psi, theta).cvodes

    def by_cvodes(x: Array, u: Array) -> Array:
        p = np.array([*u, *supply, *np.zeros(len(u) + 2), STEP])
        return np.asarray(cvodes(x0=x / scale, p=p)["xf"]).ravel() * scale

    def by_scipy(x: Array, u: Array) -> Array:
        def rates(_: float, z: Array) -> Array:
            return np.asarray(subject.rates(z * scale, u, supply, psi, theta)).ravel() / scale

        return np.asarray(solve_ivp(rates, (0.0, STEP), x / scale, method="BDF", rtol=1e-7, atol=1e-9).y[:, -1] * scale)

    reference = exact.along(at.x, np.full(SAMPLES, STEP), commands, np.tile(supply, (SAMPLES, 1)))
    ways: dict[str, Callable[[Array, Array], Array]] = {
        "compiled": lambda x, u: compiled(x, STEP, u, supply), "CVODES": by_cvodes, "SciPy BDF": by_scipy}
    fast: list[float] = []
    for way, step in ways.items():
        x, states, began = at.x, [], time.process_time()
        for u in commands:
            x = step(x, u)
            states.append(x)
        seconds = time.process_time() - began
        fast.append(SAMPLES * STEP / seconds)
        error = np.max(np.abs(np.array(states) - reference) / scale)
        print(f"  {name}: {way:9} {1e6 * seconds / SAMPLES:8.0f} us a sample, {fast[-1]:7.1f} times real time, "
              f"{fast[0] / fast[-1]:6.1f} times the compiled code's; largest error of scaled states {error:.0e}")
    return fast
