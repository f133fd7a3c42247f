"""The linear model: names, agreement with the nonlinear one, and the textbook's formula of a joint on its oil."""

import control
import numpy as np
import pytest
from typer.testing import CliRunner

import hydroopt as ho
from hydroopt.cli import app
from hydroopt.control.linear_plant import signals, state_space
from hydroopt.machine.machine_file import dump_machine
from hydroopt.model.plant import Plant
from hydroopt.model.workspace import mode, sweeps, top_speed


@pytest.fixture(scope="module")
def crane():
    """The log crane without the air in its oil."""
    data = ho.load_machine("patu655_lift").model_dump()
    data["cylinders"][0]["circuit"]["air_b"] = None
    plant = Plant(ho.Model(ho.Machine.model_validate(data)))
    return plant, plant.model.parameters.nominal, plant.parameters.nominal


def test_signals_have_names(crane):
    plant, psi, theta = crane
    system = state_space(plant, plant.steady(np.array([0.4]), np.array([0.02]), psi, theta), psi, theta)
    assert system.state_labels == signals(plant.states)
    assert (system.input_labels, system.output_labels) == (["lift_cylinder_u"], ["lift_q"])


@pytest.mark.parametrize("speed", [0.01, -0.01])
@pytest.mark.parametrize("place", [0.05, 0.6, 1.2])
def test_small_steps_of_the_nonlinear_machine(crane, place, speed):
    plant, psi, theta = crane
    at = plant.steady(np.array([place]), np.array([speed]), psi, theta)
    integrator, u = plant.integrator(psi, theta), np.array([2e-4])
    still, moved = at.x, at.x
    answer = [np.zeros_like(at.x)]
    for _ in range(60):
        still = integrator(still, 0.005, at.u, plant.supply)
        moved = integrator(moved, 0.005, at.u + u, plant.supply)
        answer.append(moved - still)
    linear = state_space(plant, at, psi, theta, outputs=plant.states)
    said = control.forced_response(linear, 0.005 * np.arange(61), np.full(61, u[0])).outputs
    rows = [plant.states.index(name) for name in ("lift.qd", "lift_cylinder.p_head", "lift_cylinder.p_rod")]
    for row in rows:
        assert np.max(np.abs(np.array(answer)[:, row] - said[row])) < 0.02 * np.max(np.abs(said[row]))


def test_frequency_is_that_of_a_mass_between_two_springs_of_oil(crane):
    """ω² = (A_a²/C_a + A_b²/C_b)/m (Merritt 1967) with the chambers' capacities C, mass m at the rod."""
    plant, psi, theta = crane
    machine, each = plant.machine, plant.actuators[0]
    q = np.array([0.5])
    at = plant.steady(q, np.array([1e-3]), psi, theta)
    length = float(plant.model.triangles["lift_cylinder"][0](q[0]))
    a, b = each.areas
    stroke = length - 0.82
    walls = [1e-3 / 500e6] * 2
    capacity = [(a * stroke + 1e-3) / 900e6 + walls[0], (b * (0.535 - stroke) + 1e-3) / 900e6 + walls[1]]
    force = [float(plant.model.inverse_dynamics(q, [0.0], [acceleration], psi)[0]) for acceleration in (0.0, 1.0)]
    lever = float(plant.actuator_motion(q, [1.0])[1])
    mass = (force[1] - force[0]) / lever
    expected = np.sqrt((a**2 / capacity[0] + b**2 / capacity[1]) / mass) / (2 * np.pi)
    found = mode(plant, machine.joints[0], at, psi, theta)
    # leaks and open edges shift a damped frequency by the square of the damping
    assert found.frequency == pytest.approx(expected, rel=0.02 + 2 * found.damping**2)
    assert 0 < found.damping < 0.5


def test_gain_is_what_a_larger_command_adds_to_the_speed(crane):
    plant, psi, theta = crane
    q = np.array([0.5])
    slow, fast = (plant.steady(q, np.array([speed]), psi, theta) for speed in (0.0499, 0.0501))
    found = mode(plant, "lift", plant.steady(q, np.array([0.05]), psi, theta), psi, theta)
    assert found.gain == pytest.approx(2e-4 / (fast.u[0] - slow.u[0]), rel=0.01)


def test_sweeps_cover_the_range_in_both_directions():
    plant = Plant(ho.Model(ho.load_machine("cat215b")))
    found = sweeps(plant, plant.model.parameters.nominal, plant.parameters.nominal, positions=3, postures=2)
    assert [(sweep.joint, np.sign(sweep.speed)) for sweep in found] == [
        (joint, sign) for joint in plant.machine.joints for sign in (1, -1)]
    assert all(sweep.each("frequency").shape == (3, 2) and np.all(sweep.each("frequency") > 0) for sweep in found)
    assert top_speed(plant, "boom") == pytest.approx(np.deg2rad(30))


def test_a_missing_supply_pressure_is_named():
    machine = ho.load_machine("cat215b")
    lacking = machine.model_copy(update={"pump": machine.pump.model_copy(update={"pressure": None})})
    plant = Plant(ho.Model(lacking))
    with pytest.raises(ho.ProblemError, match=r"supply's pressure is not known.*state 'pressure' of the pump"):
        sweeps(plant, plant.model.parameters.nominal, plant.parameters.nominal)


@pytest.mark.slow
def test_postures_without_steady_motion_are_counted_and_explained(tmp_path):
    """Half the pressure lifts in no posture, which the screen and the page say with the reason."""
    path = tmp_path / "weak.toml"
    machine = ho.load_machine("patu655_lift")
    path.write_text(dump_machine(machine.model_copy(update={
        "pump": machine.pump.model_copy(update={"pressure": 40e5})})))
    result = CliRunner().invoke(app, ["show", str(path), "--hydraulics", "-o", str(tmp_path / "out")])
    reason = "no steady motion in 45 postures; in the first, a supply of 40 bar cannot move"
    assert result.exit_code == 0
    assert reason in result.output
    assert reason in (tmp_path / "out" / "hydraulics.html").read_text("utf-8")


def test_what_has_no_mass_is_refused():
    data = ho.load_machine("patu655_lift").model_dump()
    for part in (*data["links"], data["cylinders"][0]["barrel"], data["cylinders"][0]["rod"]):
        part["body"] = None
    plant = Plant(ho.Model(ho.Machine.model_validate(data)))
    with pytest.raises(ho.ProblemError, match="nothing that 'lift' moves has a mass"):
        sweeps(plant, plant.model.parameters.nominal, plant.parameters.nominal)
