import numpy as np
import pytest

from hydroopt.errors import ProblemError
from hydroopt.logs.sensors import measure
from hydroopt.machine.sensors import Sensor


@pytest.mark.parametrize(("accuracy", "resolution", "distribution"), [
    (0.1, 0.0, "uniform"), (0.1, 0.03, "uniform"), (0.02, 0.05, "gaussian"), (0.3, None, "gaussian")])
def test_stated_std_is_what_monte_carlo_shows(accuracy, resolution, distribution):
    rng = np.random.default_rng(1)
    truth = rng.uniform(-10, 10, 200_000)
    error = measure(truth, accuracy, resolution, rng, distribution) - truth
    assert abs(error.mean()) < 2e-3
    sensor = Sensor(channels=("boom.q",), accuracy=accuracy, resolution=resolution or 0.0, distribution=distribution)
    assert error.std() == pytest.approx(sensor.std, rel=0.01)
    if distribution == "uniform":
        assert np.max(np.abs(error)) <= accuracy + (resolution or 0) / 2 + 1e-12


def test_quantised_readings_are_multiples_of_the_step():
    readings = measure(np.linspace(0, 1, 50), 0.01, 0.25, np.random.default_rng(0))
    np.testing.assert_allclose(readings / 0.25, np.round(readings / 0.25), atol=1e-12)


def test_a_perfect_sensor_changes_nothing():
    np.testing.assert_array_equal(measure([[1.0, 2.0]], 0.0, None, np.random.default_rng(0)), [[1.0, 2.0]])


@pytest.mark.parametrize("options", [
    (-1.0, None, "uniform"), (1.0, -1.0, "uniform"), (1.0, None, "triangle")])
def test_impossible_sensors_are_refused(options):
    accuracy, resolution, distribution = options
    with pytest.raises(ProblemError):
        measure([1.0], accuracy, resolution, np.random.default_rng(0), distribution)
