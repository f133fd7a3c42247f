"""Motion by sensors that lag: known lags cost hardly any accuracy, uncertain ones are found within their intervals."""

from dataclasses import replace

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.estimation.motion.problem import fit_motion, sensor_problem
from hydroopt.estimation.motion.sensed import calls_for_fit, sensed
from hydroopt.machine.machine_file import read_machine
from hydroopt.machine.parameter_kind import ParameterKind
from tests.estimation.motion.test_motion_fit import ARM, angles

FASTEST = 1.0
"""Of the motion [Hz]: readings that lag by 60 ms turn by 20 degrees of phase there."""


def arm(of_angles: str = "", of_units: str = "") -> ho.Machine:
    """The planar arm with resolvers, and lags as stated."""
    text = ARM.replace('rate = "50 Hz"\n', f'rate = "50 Hz"\n{of_units}\n')
    return read_machine(f'orientation = ["90 deg", "0 deg", "0 deg"]\n{text}[[sensors]]\n'
                        f'channels = ["boom.q", "stick.q"]\naccuracy = "0.1 deg"\n{of_angles}\n')


def simulated(machine: ho.Machine, seed: int, duration: float = 20.0):
    model = ho.Model(machine)
    course = ho.random_trajectory(model, duration=duration, rate=50.0, seed=seed, fastest=FASTEST)
    return course, ho.simulate(model, course, seed=seed + 1000)


def lags(found) -> dict[str, tuple[float, float]]:
    spread = np.sqrt(np.diag(found.covariance))
    return {each.name: (float(found.fit.value[k]), float(spread[k])) for k, each in enumerate(found.fit.common)
            if each.kind is ParameterKind.LAG}


def errors(machine: ho.Machine, course, log) -> np.ndarray:
    found = fit_motion(sensor_problem(machine, [log], geometry=False))
    inner = (log.t > 1) & (log.t < log.t[-1] - 1)
    return np.array([np.sqrt(np.mean((made - true)[inner] ** 2)) for made, true in zip(
        angles(found, log)[0][:3], (course.q, course.qd, course.qdd), strict=True)])


def test_a_known_lag_costs_hardly_any_accuracy():
    late = arm('lag = "60 ms"', 'lag = "20 ms"')
    with_lag = errors(late, *simulated(late, 3))
    without = errors(arm(), *simulated(arm(), 3))
    ignored = errors(arm(), *simulated(late, 3))
    assert np.all(with_lag < 1.5 * without)
    assert np.all(ignored > 10 * without)


def test_an_uncertain_lag_is_found_with_the_motion():
    said, (_, log) = arm('lag = { value = "45 ms", sigma = "20 ms" }'), simulated(arm('lag = "60 ms"'), 4)
    found = fit_motion(sensor_problem(said, [log], geometry=False))
    (name, (value, std)), = lags(found).items()
    assert name == "boom.q, stick.q: lag"
    assert abs(value - 0.06) < 3 * std < 0.003


def test_the_equations_are_those_of_the_objective_differentiated_numerically():
    said, (_, log) = arm('lag = { value = "45 ms", sigma = "20 ms" }'), simulated(arm('lag = "60 ms"'), 4, duration=5.0)
    fit = fit_motion(sensor_problem(said, [log], geometry=False), enough=2).fit
    place = fit.places["boom.q, stick.q: lag"]
    fit = replace(fit, value=fit.value - 0.01 * (np.arange(len(fit.value)) == place))
    (equations,), *_ = fit.linearised()
    step = np.zeros_like(fit.value)
    step[place] = 1e-5
    numeric = (replace(fit, value=fit.value - step).linearised().objective
               - replace(fit, value=fit.value + step).linearised().objective)
    by_prior = (fit.value[place] - 0.045) / 0.02**2
    assert numeric / 4e-5 == pytest.approx(equations.right_corner[place] - by_prior, rel=1e-3)
    size = fit.stretches[0].path.coefficients.shape
    for at in (3, 20, 31):
        step = np.zeros(size)
        step.flat[at] = 1e-6
        numeric = (replace(fit, stretches=(fit.stretches[0].moved(-step),)).linearised().objective
                   - replace(fit, stretches=(fit.stretches[0].moved(step),)).linearised().objective)
        assert numeric / 4e-6 == pytest.approx(equations.right[at], rel=1e-4, abs=1.0)


def test_angles_alone_that_lag_are_fitted_too():
    late = arm('lag = "60 ms"')
    course, log = simulated(late, 5)
    only = ho.Log("angles", log.t, {name: x for name, x in log.channels.items() if "_imu." not in name})
    assert calls_for_fit(late, only)
    assert not calls_for_fit(arm(), only)
    motion = sensed(late, only)[1]
    inner = motion.interior
    assert np.sqrt(np.mean((motion.q - course.q)[inner] ** 2)) < np.radians(0.03)
    assert np.sqrt(np.mean((motion.qd - course.qd)[inner] ** 2)) < 0.1 * np.sqrt(np.mean(course.qd**2))


@pytest.mark.slow
def test_intervals_of_lags_hold_the_truth():
    said, held = arm('lag = { value = "50 ms", sigma = "15 ms" }', 'lag = { value = "20 ms", sigma = "5 ms" }'), []
    for seed in range(30):
        of_angles, of_units = np.random.default_rng(seed).normal([0.05, 0.02], [0.015, 0.005]).clip(1e-3)
        _, log = simulated(arm(f'lag = "{of_angles} s"', f'lag = "{of_units} s"'), seed, duration=15.0)
        found = lags(fit_motion(sensor_problem(said, [log], geometry=False)))
        assert len(found) == 3
        held += [abs(value - (of_units if "imu" in name else of_angles)) < 1.96 * std
                 for name, (value, std) in found.items()]
    assert np.mean(held) > 0.87
