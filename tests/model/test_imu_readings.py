"""IMUs against a second derivation: forward kinematics differentiated twice over time."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hydroopt as ho
from hydroopt.errors import MachineError

STEP = 1e-3


def _model(machine: str = "excavator_imu") -> ho.Model:
    machine = ho.load_machine(machine)
    rng = np.random.default_rng(4)
    values = {}
    for imu in machine.imus:
        values |= {f"{imu.name}.{axis}": value for axis, value in zip("xyz", rng.normal(0, 1, 3), strict=True)}
        values |= {f"{imu.name}.{turn}": value
                   for turn, value in zip(("roll", "pitch", "yaw"), rng.normal(0, 0.7, 3), strict=True)}
    return ho.Model(machine.with_values(values))


def _posture(t: float) -> np.ndarray:
    return np.array([0.4 * t, -0.1 + 0.2 * np.sin(3 * t), -1.5 + 0.3 * np.cos(2 * t), -0.8 + 0.5 * np.sin(2 * t + 1)])


def _pose(model: ho.Model, imu, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and place of a unit in the base frame: from the link's far end back to its own frame."""
    names = [link.name for link in model.machine.links]
    end = np.array(model.forward_kinematics(_posture(t))[names.index(imu.link)])
    joint = model.machine.link(imu.link).joint
    back = Rotation.from_euler("x", joint.alpha).as_matrix() @ Rotation.from_euler("y", joint.beta).as_matrix()
    turn = end[:3, :3] @ back.T
    origin = end[:3, 3] - turn @ [joint.a, 0, 0]
    own = Rotation.from_euler("xyz", imu.orientation).as_matrix()
    return turn @ own, origin + turn @ np.array(imu.position)


def test_imus_read_what_forward_kinematics_differentiated_twice_gives():
    model = _model()
    t = 0.7
    rates = [(_posture(t + STEP) - _posture(t - STEP)) / (2 * STEP),
             (_posture(t + STEP) - 2 * _posture(t) + _posture(t - STEP)) / STEP**2]
    readings = np.array(model.imu_readings(_posture(t), *rates))
    for k, imu in enumerate(model.machine.imus):
        turn, place = _pose(model, imu, t)
        before, after = _pose(model, imu, t - STEP), _pose(model, imu, t + STEP)
        acceleration = (after[1] - 2 * place + before[1]) / STEP**2 + [0, 0, model.machine.gravity]
        omega = Rotation.from_matrix(before[0].T @ after[0]).as_rotvec() / (2 * STEP)
        np.testing.assert_allclose(readings[3:6, k], turn.T @ acceleration, atol=1e-4)
        np.testing.assert_allclose(readings[:3, k], omega, atol=1e-5)
        _, pitch, roll = Rotation.from_matrix(turn).as_euler("ZYX")
        np.testing.assert_allclose(readings[6:, k], [roll, pitch], atol=1e-9)


def test_a_simulated_imu_has_its_noise_and_a_bias_and_no_joint_is_read():
    model = ho.Model(ho.load_machine("excavator_imu"))
    motion = ho.random_trajectory(model, duration=40.0, rate=100.0, seed=1)
    exact, noisy = (ho.simulate(model, motion, noise=noise, seed=3) for noise in (False, True))
    assert not [channel for channel in noisy.channels if channel.endswith((".q", ".length"))]
    biases = []
    for imu in model.machine.imus:
        for channel in imu.channels:
            error = noisy.channel(channel) - exact.channel(channel)
            part = imu.part(channel)
            biases.append(np.mean(error) / part.bias)
            assert np.std(error) == pytest.approx(part.noise * np.sqrt(imu.rate / 2), rel=0.1)
    assert 0.5 < np.std(biases) < 1.6
    assert len(set(np.round(biases, 6))) == len(biases)


@pytest.mark.parametrize(("text", "said"), [
    ('link = "arm"', "'arm', which does not exist"),
    ('link = "boom"', "measures nothing"),
])
def test_a_wrong_imu_is_refused(text, said, tmp_path):
    file = tmp_path / "own.toml"
    gyro = 'gyroscope = { noise = "0.01 deg/s/Hz^0.5", bias = "0.2 deg/s" }' if "arm" in text else ""
    file.write_text('name = "own"\nbased_on = "cat215b"\n[[imus]]\nname = "unit"\nrate = "100 Hz"\n'
                    f'position = ["0 m", "0 m", "0 m"]\n{text}\n{gyro}\n')
    with pytest.raises(MachineError, match=said):
        ho.load_machine(file)
