"""Valves and oil of one actuator: `identify-valves` as a process, and its solver against SciPy on the same balances."""

import subprocess
import tempfile
import time

import numpy as np
from scipy.optimize import least_squares

from hydroopt import hydraulic_problem, load_machine, read_log
from hydroopt.estimation.hydraulic.adjustment import adjust
from studies.bench.goals import Row
from studies.bench.process import HYDROOPT, measured

SECONDS, RATE = "7", "100"
MACHINES = ("patu655_lift", "cat215b")
"""The last is the goal's."""


def valves() -> list[Row]:
    """CPU seconds of `identify-valves`, page included, 7 s at 100 Hz; its solver and SciPy's least_squares with a
    numeric Jacobian on the same balances, weighted once."""
    with tempfile.TemporaryDirectory() as folder:
        for name in MACHINES:
            log = f"{folder}/{name}"
            subprocess.run([HYDROOPT, "simulate", name, "--driven", "--duration", SECONDS, "--rate", RATE, "--truth",
                            "random", "--seed", "1", "-o", log, "--quiet"], check=True)
            command = [HYDROOPT, "identify-valves", name, f"{log}/log.csv", "-o", f"{log}/out", "--quiet"]
            process = min(measured(command).cpu for _ in range(3))  # the first leaves bytecode and kernels
            problem = hydraulic_problem(load_machine(name), [read_log(f"{log}/log.csv")])
            stretches, known = problem.balanced, problem.parameters
            began = time.process_time()
            ours = adjust(stretches, known, len(problem.plant.actuators))
            own = time.process_time() - began
            factors = []
            for each in stretches:
                at = each.balance.misclosure(each.readings, each.readings.values, known.nominal)
                begin = each.readings.begin
                sizes = np.sqrt(np.sum(at.by_first**2 * each.readings.variance[begin:-1, None], axis=2)
                                + np.sum(at.by_last**2 * each.readings.variance[begin + 1 :, None], axis=2))
                factors.append(sizes)

            def residuals(z: np.ndarray, stretches=stretches, known=known, factors=factors) -> np.ndarray:
                theta = known.nominal + known.scale * z
                return np.concatenate([z, *((each.balance.misclosure(
                    each.readings, each.readings.values, theta).value / size).ravel()
                    for each, size in zip(stretches, factors, strict=True))])

            began = time.process_time()
            theirs = least_squares(residuals, np.zeros(len(known)), bounds=(
                (known.lower - known.nominal) / known.scale, (known.upper - known.nominal) / known.scale))
            scipy = time.process_time() - began
            apart = np.max(np.abs(theirs.x - (ours.theta - known.nominal) / known.scale))
            print(f"  {name}: process {process:.2f} s, solver {own:.2f} s, SciPy {scipy:.2f} s, ratio "
                  f"{scipy / own:.1f}; apart by at most {apart:.1f} prior σ, since SciPy corrects no reading")
    return [Row("valves", process, "SciPy's least_squares, solver alone,", scipy)]
