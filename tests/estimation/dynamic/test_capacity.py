"""The load that actuators hold: by the side of the piston that carries it, and by which pressure."""

import numpy as np
import pytest

from hydroopt.estimation.dynamic.claims import WORKING_PRESSURE, capacity
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine, read_machine
from hydroopt.model.model import Model
from hydroopt.results.verdict import Claim, Purpose, Usable
from hydroopt.simulation.simulate import random_trajectory, simulate

LIFT = load_machine("patu655_lift")


def without_relief() -> Machine:
    cylinder = LIFT.cylinders[0].model_copy(update={"relief_pressure": None})
    return LIFT.model_copy(update={"cylinders": (cylinder,)})


@pytest.mark.parametrize(("force", "effect"), [(3e4, 70.0), (-3e4, -70.0), (-3e4, 70.0)])
def test_a_cylinder_pushes_with_its_head_side_and_pulls_with_its_rod_side(force: float, effect: float) -> None:
    head, rod = LIFT.cylinders[0].areas
    found = capacity(LIFT, np.array([force]), np.array([effect]), np.eye(1), {})
    most = (head if effect > 0 else rod) * 2.1e7
    assert found.load == pytest.approx((most - np.sign(effect) * force) / abs(effect))
    assert (found.holder, found.pressure, found.missing) == ("lift_cylinder", 2.1e7, ())


def test_what_holds_not_even_itself_holds_no_load() -> None:
    assert capacity(LIFT, np.array([1e6]), np.array([70.0]), np.eye(1), {}).load == 0.0


def test_without_relief_a_pressure_is_assumed_or_was_reached() -> None:
    machine, args = without_relief(), (np.array([3e4]), np.array([70.0]), np.eye(1))
    for reached, pressure in ((1.5e7, WORKING_PRESSURE), (2.4e7, 2.4e7)):
        found = capacity(machine, *args, {"lift_cylinder": reached})
        assert (found.pressure, found.missing) == (pressure, ("lift_cylinder",))
        assert found.owner == "its"


def test_passive_joints_hold_nothing_and_take_nothing() -> None:
    """A hinge of a hanging grapple has no actuator, so that what a load does there limits nothing."""
    machine = load_machine("forestry_crane")
    passive = np.array([not each.actuators for each in machine.balances])
    assert passive.any()
    effect = np.where(passive, 100.0, 1.0)
    shares = Model(machine).over(Model(machine).shares, np.zeros((1, len(machine.joints))))[0][0]
    assert capacity(machine, np.zeros(len(effect)), effect, shares, {}).load > 1000


TWO = """
name = "two"
orientation = ["90 deg", "0 deg", "0 deg"]
[[sensors]]
channels = ["lift.q", "tilt.q"]
accuracy = "0.05 deg"
[[sensors]]
channels = ["lift_cylinder.p_head", "lift_cylinder.p_rod", "tilt_cylinder.p_head", "tilt_cylinder.p_rod"]
accuracy = "0.5 bar"
[[links]]
name = "lift"
joint = { type = "revolute", a = "1.5 m", lower = "-20 deg", upper = "60 deg" }
[links.body]
m = { value = "60 kg", sigma = "15 %" }
com = { value = ["0.7 m", "0 m", "0 m"], sigma = "0.1 m" }
inertia_com = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "12 kg*m^2", "0 kg*m^2", "12 kg*m^2"]
[[links]]
name = "tilt"
joint = { type = "revolute", a = "1.3 m", lower = "-110 deg", upper = "-15 deg" }
[links.body]
m = { value = "90 kg", sigma = "15 %" }
com = { value = ["0.9 m", "0 m", "0 m"], sigma = "0.1 m" }
inertia_com = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "12 kg*m^2", "0 kg*m^2", "12 kg*m^2"]
[[cylinders]]
name = "lift_cylinder"
bore = "80 mm"
rod_diameter = "45 mm"
dead_length = "0.66 m"
stroke = "0.55 m"
barrel = { link = "base", pin = ["0.1 m", "-0.65 m", "0 m"] }
rod = { link = "lift", pin = ["0.6 m", "0.05 m", "0 m"] }
[[cylinders]]
name = "tilt_cylinder"
bore = "80 mm"
rod_diameter = "45 mm"
dead_length = "0.74 m"
stroke = "0.31 m"
barrel = { link = "lift", pin = ["0.6 m", "0.18 m", "0 m"] }
rod = { link = "tilt", pin = ["-0.17 m", "0.08 m", "0 m"] }
"""


def claims(text: str) -> dict[Purpose, list[Claim]]:
    model = Model(read_machine(text))
    logs = [simulate(model, random_trajectory(model, duration=8, rate=25.0, seed=k), seed=k) for k in (1, 2)]
    found = identify(identification_problem(model, logs[:1], logs[1:]).by_data_alone(), "wls").verdict.claims
    return {purpose: [claim for claim in found if claim.purpose is purpose] for purpose in Purpose}


def test_the_verdict_says_by_which_pressure_a_load_is_judged() -> None:
    weighing, = claims(TWO)[Purpose.WEIGHING]
    assert "at 200 bar (assumed: state its relief_pressure)" in weighing.condition


def test_a_joint_without_measured_forces_is_neither_validated_nor_controlled_nor_weighs() -> None:
    second = TWO[TWO.index("[[cylinders]]"):TWO.index('[[cylinders]]\nname = "tilt_cylinder"')]
    found = claims(TWO + second.replace('"lift_cylinder"', '"second"\nmeasured = false'))
    lift, = (claim for claim in found[Purpose.FORCE] if claim.of == "lift")
    assert lift.usable is Usable.NO
    assert "second not measured" in lift.reason
    control, = found[Purpose.CONTROL]
    weighing, = found[Purpose.WEIGHING]
    assert control.usable is Usable.NO
    assert weighing.usable is Usable.UNTESTED
    assert "no log tells the force at lift" in weighing.reason
