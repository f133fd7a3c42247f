"""Franka Panda, the published exciting trajectory: condition number and errors by the definitions of their source."""

from pathlib import Path

import numpy as np

from hydroopt import Log, Model, SmoothingSpline, identification_problem, load_machine, solve
from hydroopt.estimation.dynamic.experiment import experiment
from hydroopt.estimation.inference.identifiability import analyse
from hydroopt.logs.smoothing import condition

DATA = Path(__file__).parents[3] / "shared" / "data" / "panda_gaz2019" / "rbt_log"
SIGMOID = np.array([[0.54615, 0.87224, 0.64068, 1.2794, 0.83904, 0.30301, 0.56489],
                    [5.1181, 9.0657, 10.136, 5.5903, 8.3469, 17.133, 10.336],
                    [0.039533, 0.025882, -0.04607, 0.036194, 0.026226, -0.021047, 0.0035526]])
"""φ1 [N·m], φ2 [s/rad] and φ3 [rad/s] of the published friction φ1/(1 + exp(−φ2·(q̇ + φ3))) − φ1/(1 + exp(−φ2·φ3))."""
RAMP = 0.5
"""Duration [s] of the ramps at both ends, which the published trajectory adds to its Fourier series."""


def run() -> dict | None:
    """Condition numbers and relative errors ‖error‖/‖torque‖ over all joints; None where the data are not at hand."""
    if not DATA.exists():
        return None
    machine = load_machine("panda")
    log, stamped = recordings()
    results = {"samples": len(stamped.t), "rows_with_a_new_state": len(log.t)}
    whole = identification_problem(machine, [log])
    results["angle_noise_rad"] = noise(whole.model, log)
    results["angle_noise_by_the_logger's_stamps_rad"] = noise(whole.model, stamped)
    for clock, recorded in (("robot", log), ("logger", stamped)):
        problem = identification_problem(machine, [recorded], smoothing=SmoothingSpline(bandwidth=20.0))
        fit = solve(problem, "wls", intervals=False).fit["train"]["all"]
        results[f"angles_to_20_Hz_by_the_{clock}'s_clock_unfiltered"] = round(100 * fit.relative, 2)
    results |= conditions(whole)
    for method in ("wls", "sdp"):
        estimate = solve(whole, method, intervals=False)
        results |= {f"{method}_relative_error{name}": relative(estimate, whole.experiments[0], limit)
                    for name, limit in (("", machine.bandwidth), ("_below_10_Hz", 10.0), ("_below_15_Hz", 15.0),
                                        ("_unfiltered", None))}
        results[f"{method}_inconsistent_bodies"] = sum(s < 0 for s in estimate.consistency.values())
        first, second = log.split(0.5)
        for name, learnt, unseen in (("second_half", first, second), ("first_half", second, first)):
            problem = identification_problem(machine, [learnt], [unseen])
            judged = solve(problem, method, intervals=False)
            results |= {f"{method}_unseen_{name}": relative(judged, problem.validation[0], machine.bandwidth),
                        f"{method}_unseen_{name}_unfiltered": relative(judged, problem.validation[0], None)}
    data = whole.experiments[0]
    slow = condition(log.t, data.force, smoothing=SmoothingSpline(bandwidth=20.0)).q
    results["torque_above_20_Hz"] = round(float(np.linalg.norm(data.force - slow) / np.linalg.norm(data.force)), 4)
    return results


def recordings() -> tuple[Log, Log]:
    """The run in the robot's own time, and as the logger stamped it.

    The robot works in steps of 1 ms; the logger, which did not keep up with them, wrote some states twice and missed
    others. How many steps lie between two states is told by the change of the angles over the velocities, which
    scatters by a hundredth of a step, and by the stamps only while the robot stands still.
    """
    t, q, qd, tau = (np.loadtxt(DATA / f"exciting_traj_{name}.txt").reshape(-1, columns)
                     for name, columns in (("time", 1), ("positions", 7), ("velocity", 7), ("torques", 7)))
    new = np.r_[True, np.any(np.diff(q, axis=0) != 0, axis=1)]
    speed = (qd[new][1:] + qd[new][:-1]) / 2
    size = np.sum(speed**2, axis=1)
    told = np.sum(speed * np.diff(q[new], axis=0), axis=1) / np.maximum(size, 1e-12)
    steps = np.maximum(np.round(1e3 * np.where(size > 0.2**2, told, np.diff(t[new, 0]))), 1)
    return (as_log("robot_clock", 1e-3 * np.r_[0, np.cumsum(steps)], q[new], tau[new]),
            as_log("logger_clock", t[:, 0], q, tau))


def as_log(name: str, t: np.ndarray, q: np.ndarray, tau: np.ndarray) -> Log:
    """One stretch: the longest gap, 9 ms, is nothing to a motion of less than a hertz."""
    channels = {f"joint{k + 1}.{kind}": values[:, k] for kind, values in (("q", q), ("tau", tau)) for k in range(7)}
    return Log(name, t, channels, segment=np.zeros(len(t), int))


def noise(model: Model, log: Log) -> float:
    """What smoothing at 10 Hz takes out of the angles: the RMS of all joints [rad]."""
    found = experiment(model, log, SmoothingSpline(bandwidth=10.0)).motion.q
    return float(f"{np.sqrt(np.mean([(log.channel(f'joint{k + 1}.q') - found[:, k])**2 for k in range(7)])):.2g}")


def conditions(problem) -> dict:
    """Condition numbers of the stacked regressor of base parameters and friction, columns as they are."""
    model, motion = problem.model, problem.experiments[0].motion
    regressor = model.over(model.regressor, motion.q, motion.qd, motion.qdd)[0]
    inertial = [k for k, name in enumerate(model.parameters.names) if "drive" not in name]
    base = analyse(regressor[:, :, inertial].reshape(-1, len(inertial)), [model.parameters.names[k] for k in inertial])
    bodies = regressor[:, :, [inertial[k] for k in base.basis]]
    qd = motion.qd
    offset, sigmoid = np.ones_like(qd), 1 / (1 + np.exp(-SIGMOID[1] * (qd + SIGMOID[2])))
    results = {"base_parameters": base.rank}
    for span, inside in (("", motion.t >= 0), ("_without_ramps", (motion.t > RAMP) & (motion.t < motion.t[-1] - RAMP))):
        for name, terms in (("", (sigmoid, offset)), ("_linear_friction", (qd, np.sign(qd), offset)),
                            ("_bodies_alone", ()), ("_bodies_and_offset", (offset,))):
            stacked = np.concatenate([bodies, *(term[:, :, None] * np.eye(7) for term in terms)], axis=2)[inside]
            triangle = np.linalg.qr(stacked.reshape(-1, stacked.shape[2]), mode="r")
            results[f"condition{name}{span}"] = round(float(np.linalg.cond(triangle)), 2)
            if not span and name in ("", "_linear_friction"):
                scaled = triangle / np.linalg.norm(triangle, axis=0)
                results[f"condition{name}_unit_columns"] = round(float(np.linalg.cond(scaled)), 2)
    return results


def relative(estimate, data, limit: float | None) -> float:
    """‖error‖/‖torque‖ in per cent over all joints, of the measured torques below a frequency [Hz]."""
    force = data.force
    if limit is not None:
        force = condition(data.log.t, force, smoothing=SmoothingSpline(bandwidth=limit)).q
    error = (force - estimate.predict(data))[data.inside]
    return round(100 * float(np.linalg.norm(error) / np.linalg.norm(force[data.inside])), 3)
