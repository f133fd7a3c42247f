"""Sjöberg's hydraulic crane: valve, oil and a flexible arm fitted to 512 samples, the next 512 run freely."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure
from scipy.io import loadmat
from scipy.optimize import least_squares

from hydroopt.estimation.hydraulic.bounded_gaussian import BoundedGaussian
from hydroopt.estimation.hydraulic.estimate import parameter_diagnostics
from hydroopt.model.hydraulics import hinge, orifice
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.results.diagnostic import of_kind
from studies.show import look, save, table

DATA = Path(__file__).parents[2] / "data" / "sjoberg_hydraulic_actuator" / "actuator.mat"
TRAIN = 512
"""Samples that are fitted; the others are predicted."""
CHOICE = 350
"""Samples that were fitted when structures were judged by the rest of the first TRAIN."""
STARTS = 5
"""From how many places the fit is sought."""
DELAY = 2.0
"""Samples by which commands arrive later."""
LAMINAR = 0.2
"""Pressure drop [p] below which flow is laminar."""
ROUNDING = 0.01, 0.02
"""Command [u] over which the dead band, and the end of the spool's travel, set in."""
SIGMA = np.array([0.9, 0.3])
"""Standard deviations of p and x as if errors were new at every sample: about 0.28 and 0.03, but they last."""

NUMBERS = {  # unit, start, lower, upper
    "valve.natural_frequency": ("rad/sample", 1.0, 0.2, 5.0),
    "valve.dead_band": ("[u]", 0.05, -0.2, 0.3),
    "valve.dead_band_reverse": ("[u]", 0.02, -0.2, 0.3),
    "valve.travel": ("[u]", 0.55, 0.1, 1.3),
    "valve.travel_reverse": ("[u]", 0.8, 0.1, 1.3),
    "valve.gain": ("[x]/(sample*[u])", 0.037, 0.005, 0.3),
    "valve.gain_reverse": ("[x]/(sample*[u])", 0.05, 0.005, 0.3),
    "supply.pressure": ("[p]", 6.5, 3.9, 100.0),
    "oil.stiffness": ("[p]/[x]", 300.0, 10.0, 3000.0),
    "leakage": ("[x]/(sample*[p])", 1e-4, 0.0, 0.02),
    "drive.inertia": ("[p]*sample^2/[x]", 100.0, 5.0, 1e4),
    "drive.viscous": ("[p]*sample/[x]", 30.0, 0.0, 150.0),
    "drive.viscous_reverse": ("[p]*sample/[x]", 30.0, 0.0, 150.0),
    "drive.quadratic": ("[p]*sample^2/[x]^2", 100.0, 0.0, 3000.0),
    "arm.inertia": ("[p]*sample^2/[x]", 500.0, 50.0, 1e4),
    "arm.stiffness": ("[p]/[x]", 50.0, 0.1, 500.0),
    "arm.damping": ("[p]*sample/[x]", 1.0, 0.0, 100.0)}

PARTS = 8
"""Steps of integration in a sample."""
FIRST, FAR = 1e-3, 1e3
"""Standard deviation of the first states about rest; what a residual that is no number counts as."""

STATES = {"spool": 1.0, "spool_rate": 0.1, "p": 1.0, "drive_speed": 0.02, "x": 1.0, "arm_speed": 0.02, "arm_load": 1.0}
"""With their typical sizes."""


def rates() -> ca.Function:
    """(x, u, θ) → ẋ: valve, oil, drive and arm in the data's own units; flows are the drive's speeds that they cause.

    p is the load's pressure, the difference between both chambers. A negative u opens the valve towards greater x.
    """
    x, u, theta = ca.SX.sym("x", len(STATES)), ca.SX.sym("u"), ca.SX.sym("theta", len(NUMBERS))
    spool, spool_rate, p, drive_speed, _, arm_speed, arm_load = ca.vertsplit(x)
    value = dict(zip(NUMBERS, ca.vertsplit(theta), strict=True))

    def flow(side: ca.SX, load: ca.SX, suffix: str) -> ca.SX:
        beyond = side - value[f"valve.dead_band{suffix}"]
        opening = hinge(beyond, ROUNDING[0]) - hinge(beyond - value[f"valve.travel{suffix}"], ROUNDING[1])
        supply = value["supply.pressure"]
        return orifice(value[f"valve.gain{suffix}"] * opening / ca.sqrt(supply), supply, load, LAMINAR)

    omega = value["valve.natural_frequency"]
    net = flow(spool, p, "") - flow(-spool, -p, "_reverse") - value["leakage"] * p - drive_speed
    friction = (value["drive.viscous"] * hinge(drive_speed, 1e-3)
                - value["drive.viscous_reverse"] * hinge(-drive_speed, 1e-3)
                + value["drive.quadratic"] * drive_speed * ca.sqrt(drive_speed**2 + 1e-8))
    arm = arm_load + value["arm.damping"] * (drive_speed - arm_speed)
    return ca.Function("rates", [x, u, theta], [ca.vertcat(
        spool_rate, omega**2 * (-u - spool) - 2 * omega * spool_rate, value["oil.stiffness"] * net,
        (p - friction - arm) / value["drive.inertia"], arm_speed, arm / value["arm.inertia"],
        value["arm.stiffness"] * (drive_speed - arm_speed))])


@cache
def runs(count: int) -> ca.Function:
    """(first states, u, θ) → p and x (2, count): Runge and Kutta's steps of a fraction of a sample, u straight between.
    """
    rate, x, theta = rates(), ca.SX.sym("x", len(STATES)), ca.SX.sym("theta", len(NUMBERS))
    begin, end, after = ca.SX.sym("begin"), ca.SX.sym("end"), x
    for k in range(PARTS):
        u = [begin + (end - begin) * (k + part) / PARTS for part in (0, 0.5, 1)]
        one = rate(after, u[0], theta) / PARTS
        two = rate(after + one / 2, u[1], theta) / PARTS
        three = rate(after + two / 2, u[1], theta) / PARTS
        after += (one + 2 * two + 2 * three + rate(after + three, u[2], theta) / PARTS) / 6
    step = ca.Function("step", [x, ca.vertcat(begin, end), theta], [after]).mapaccum(count - 1)
    first, u, theta = ca.MX.sym("first", len(STATES)), ca.MX.sym("u", count), ca.MX.sym("theta", len(NUMBERS))
    states = ca.horzcat(first, step(first, ca.horzcat(u[:-1], u[1:]).T, ca.repmat(theta, 1, count - 1)))
    return ca.Function("runs", [first, u, theta], [states[[2, 4], :]])


@dataclass(frozen=True)
class Fitted:
    """The most probable numbers and first states."""

    posterior: BoundedGaussian
    first: np.ndarray

    def free_run(self, u: np.ndarray) -> np.ndarray:
        """p and x (2, N), from the first states on by u (N,) alone."""
        return np.asarray(runs(len(u))(self.first, late(u), self.posterior.theta))


def late(u: np.ndarray) -> np.ndarray:
    """u as it arrives."""
    sample = np.arange(float(len(u)))
    return np.interp(sample - DELAY, sample, u)


def identified(u: np.ndarray, p: np.ndarray, x: np.ndarray, starts: int = 1) -> Fitted:
    """The numbers most probable for readings of p and x, by the best of several starts a factor of about 1.3 apart."""
    units, *columns = zip(*NUMBERS.values(), strict=True)
    start, lower, upper = np.array(columns)
    parameters = ParameterSet(tuple(NUMBERS), (ParameterKind.COEFFICIENT,) * len(start), units, start, lower, upper,
                              start, np.zeros((len(start),) * 2))
    rest = np.zeros(len(STATES))
    rest[[0, 2]], size, n = (-late(u)[0], p[0]), np.array(list(STATES.values())), len(start)
    z = ca.MX.sym("z", n + len(STATES))
    theta, first = start * z[:n], rest + FIRST * z[n:]
    rows = ca.vertcat(ca.vec((runs(len(u))(first, late(u), theta) - np.vstack([p, x - x[0]])) / SIGMA), z[n:])
    value, slope = ca.Function("value", [z], [rows]), ca.Function("slope", [z], [ca.jacobian(rows, z)])
    factors = np.exp(0.3 * np.random.default_rng(0).standard_normal((starts, n)))
    factors[0] = 1.0
    free = np.full(len(size), np.inf)
    bounds = np.append(lower / start, -free), np.append(upper / start, free)

    def residuals(at: np.ndarray) -> np.ndarray:
        return np.nan_to_num(np.asarray(value(at)).ravel(), nan=FAR, posinf=FAR, neginf=-FAR)

    begins = [np.append(np.clip(factor, *(bound[:n] for bound in bounds)), 0 * size) for factor in factors]
    best = min((least_squares(residuals, begin, lambda at: np.asarray(slope(at)), bounds, x_scale="jac", ftol=1e-12,
                              xtol=1e-12, gtol=1e-12, max_nfev=500) for begin in begins), key=lambda one: one.cost)
    inner = np.linalg.qr(best.jac[:, ::-1], mode="r")[len(size):, len(size):][:, ::-1] / start
    scale = np.sqrt(2 * best.cost / (len(best.fun) - 2 * len(size) - n))
    return Fitted(BoundedGaussian(parameters, start * best.x[:n], inner.T @ inner, best.grad[:n] / start, scale),
                  rest + FIRST * best.x[n:])


def arx(u: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Free run of the linear ARX(3, 2) model fitted by least squares, from the last pressures of the fitted half."""
    rows = np.column_stack([p[2:-1], p[1:-2], p[:-3], u[2:-1], u[1:-2]])
    numbers = np.linalg.lstsq(rows[: TRAIN - 3], p[3:TRAIN], rcond=None)[0]
    run = p[:TRAIN].tolist()
    for k in range(TRAIN, len(p)):
        run.append(float(numbers @ [run[-1], run[-2], run[-3], u[k - 1], u[k - 2]]))
    return np.array(run)


def rmse(error: np.ndarray) -> float:
    """Root of the mean square."""
    return round(float(np.sqrt(np.mean(error**2))), 4)


def run() -> dict:
    """RMSE of p, simulated from u alone from the first sample on; what its parameters are known to."""
    content = loadmat(DATA)
    u, p, x = (content[name].ravel() for name in "upx")
    first = [values[:TRAIN] for values in (u, p, x)]
    chosen = identified(*(values[:CHOICE] for values in first)).free_run(first[0])[0]

    fitted = identified(*first, STARTS)
    estimate, simulated = fitted.posterior, fitted.free_run(u).T
    error = simulated[:, 0] - p
    table("Parameters", ["", "value", "95 % from", "to", "unit"],
          [[name, float(value), *(["at its bound"] * 2 if held else map(float, interval)), NUMBERS[name][0]]
           for name, value, interval, held in zip(NUMBERS, estimate.theta, estimate.ci95, estimate.at_bound,
                                                  strict=True)])
    draw(p, simulated[:, 0])
    needed = [float(np.sqrt(np.mean(e**2) * correlation_time(e))) for e in
              (simulated[:TRAIN, 0] - first[1], simulated[:TRAIN, 1] - first[2] + x[0])]
    diagnostics = parameter_diagnostics(estimate)
    with_zero = estimate.ci95[:, 0] * estimate.ci95[:, 1] < 0
    return {
        "test_rmse": rmse(error[TRAIN:]), "train_rmse": rmse(error[:TRAIN]),
        "choice_rmse": rmse(chosen[CHOICE:] - p[CHOICE:TRAIN]),
        "arx_test_rmse": rmse((arx(u, p) - p)[TRAIN:]), "test_spread_of_p": rmse(p[TRAIN:] - np.mean(p[TRAIN:])),
        "sigma_needed_over_stated": round(float(np.max(needed / SIGMA)), 3),
        "leakage_not_told": any(
            each.subject == ("leakage",) for each in of_kind(diagnostics, "little information in the data")),
        "intervals_with_zero": [name for name, so in zip(NUMBERS, with_zero, strict=True) if so],
        "diagnostics": [each.text for each in diagnostics]}


def correlation_time(residual: np.ndarray) -> float:
    """Samples that carry as much as one independent sample (Geyer 1992, initial monotone sequence)."""
    centred = residual - residual.mean()
    lagged = np.correlate(centred, centred, "full")[len(centred) - 1 :][: int(0.95 * len(centred))]
    correlation = lagged / np.arange(len(centred), len(centred) - len(lagged), -1) / np.mean(centred**2)
    pairs = correlation[: len(lagged) // 2 * 2].reshape(-1, 2).sum(axis=1)
    end = np.argmax(pairs <= 0) if np.any(pairs <= 0) else len(pairs)
    return max(1.0, 2 * float(np.sum(np.minimum.accumulate(pairs[:end]))) - 1)


def draw(p: np.ndarray, simulated: np.ndarray) -> None:
    """Measured and simulated pressure over all samples."""
    with look():
        figure = Figure(figsize=(11, 4), layout="constrained")
        ax = figure.subplots()
        ax.plot(p, label="measured")
        ax.plot(simulated, label="simulated from u alone")
        ax.axvline(TRAIN, color="0.5", linewidth=0.8)
        ax.set(xlabel="sample (fitted up to 512)", ylabel="p [unit of the data]", xlim=(0, len(p)))
        ax.legend()
    save(figure, "sjoberg_actuator", "free_run")
