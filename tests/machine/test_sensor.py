import numpy as np
import pytest

from hydroopt.machine.sensors import Sensor


def sensor(accuracy, resolution, distribution="uniform"):
    return Sensor(channels=("boom.q",), accuracy=accuracy, resolution=resolution, distribution=distribution)


@pytest.mark.parametrize(("accuracy", "resolution", "distribution"), [
    (0.1, 0.0, "uniform"), (0.1, 0.03, "uniform"), (0.02, 0.05, "gaussian"), (0.3, 0.0, "gaussian")])
def test_stated_std_is_what_monte_carlo_shows(accuracy, resolution, distribution):
    rng, used = np.random.default_rng(1), sensor(accuracy, resolution, distribution)
    truth = rng.uniform(-10, 10, 200_000)
    error = used.read(truth, rng) - truth
    assert abs(error.mean()) < 2e-3
    assert error.std() == pytest.approx(used.std, rel=0.01)
    if distribution == "uniform":
        assert np.max(np.abs(error)) <= accuracy + resolution / 2 + 1e-12


def test_quantised_readings_are_multiples_of_the_step():
    readings = sensor(0.01, 0.25).read(np.linspace(0, 1, 50), np.random.default_rng(0))
    np.testing.assert_allclose(readings / 0.25, np.round(readings / 0.25), atol=1e-12)


def test_a_perfect_sensor_changes_nothing():
    true = np.array([[1.0, 2.0]])
    np.testing.assert_array_equal(sensor(0.0, 0.0).read(true, np.random.default_rng(0)), true)


@pytest.mark.parametrize("options", [(-1.0, 0.0, "uniform"), (1.0, -1.0, "uniform"), (1.0, 0.0, "triangle")])
def test_impossible_sensors_are_refused(options):
    with pytest.raises(ValueError, match=r"accuracy|resolution|distribution"):
        sensor(*options)


@pytest.mark.parametrize("channel", ["", "boom", "boom.", "boom.angle"])
def test_a_channel_that_is_none_is_refused(channel):
    with pytest.raises(ValueError, match=f"'{channel}' is the name of no channel"):
        Sensor(channels=("boom.q", channel), accuracy=0.1)


@pytest.mark.parametrize("accuracy", ["1e20 bar", "1e300 N", "1e300 N*m"])
def test_a_size_that_no_machine_has_is_refused_as_such_whatever_units_are_allowed(accuracy):
    with pytest.raises(ValueError, match="is beyond any machine"):
        Sensor(channels=("boom.q",), accuracy=accuracy)
