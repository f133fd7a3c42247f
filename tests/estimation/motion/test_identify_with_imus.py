"""Identification from a motion that IMUs tell: what the uncertainty of a position does to verdict and tests of fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.estimation.dynamic.log_check import check_logs
from hydroopt.estimation.dynamic.misfit.naming import examine_fit
from hydroopt.estimation.dynamic.misfit.readings import ForceReadings
from hydroopt.estimation.motion import misread
from hydroopt.estimation.motion import sensed as module
from hydroopt.machine.machine_file import read_machine
from hydroopt.results.diagnostic import of_kind
from tests.estimation.motion.test_motion_fit import ARM, simulated

BODIES = ('body = { m = { value = "300 kg", sigma = "30 %" }, com = { value = ["1.4 m", "0.1 m", "0 m"], '
          'sigma = "30 %" }, inertia_com = { value = ["5 kg*m^2", "0 kg*m^2", "0 kg*m^2", "150 kg*m^2", "0 kg*m^2", '
          '"150 kg*m^2"], sigma = "30 %" } }')
SENSORS = '''
[[sensors]]
channels = ["boom.tau", "stick.tau"]
accuracy = "40 N*m"
rate = "50 Hz"
'''


def arm(*, stick_exact: bool, bodies_within: str = "30 %") -> ho.Machine:
    bodies = BODIES.replace("30 %", bodies_within)
    text = ARM.replace("\n[[drives]]", f"\n{bodies}\n[[drives]]", 1).replace('\n[[links]]\nname = "stick"', (
        f'\n{bodies}\n[[links]]\nname = "stick"'))
    if stick_exact:
        before, _, after = text.rpartition(', sigma = "2 deg" }')
        text = f"{before} }}{after}"
    return read_machine(f"orientation = [\"90 deg\", \"0 deg\", \"0 deg\"]\n{text}{SENSORS}")


@pytest.fixture(scope="module")
def uncertain() -> tuple[ho.Machine, ho.Log]:
    """The arm, and a log of one whose stick has its IMU turned by 3°; the file states 2°."""
    machine = arm(stick_exact=False)
    turned = machine.with_values({"stick_imu.yaw": np.radians(3.0)})
    return machine, simulated(turned, 3)[1]


def test_a_position_that_is_hardly_known_makes_the_answer_suspect(uncertain: tuple[ho.Machine, ho.Log]) -> None:
    machine, log = uncertain
    found = ho.solve(ho.identification_problem(machine, [log]), intervals=False)
    (said,) = of_kind(found.diagnostics, "uncertain position of a joint taken as exact")
    assert said.subject == ("stick",)
    assert 1.0 < said.evidence["std"] < 2.5
    assert found.status == "suspect"
    assert any("at rest" in step.text for step in found.verdict.next_steps)
    exact = ho.solve(ho.identification_problem(arm(stick_exact=True), [simulated(arm(stick_exact=True), 3)[1]]),
                     intervals=False)
    assert not of_kind(exact.diagnostics, "uncertain position of a joint taken as exact")
    assert exact.status == "ok"


def test_tests_of_fit_know_of_the_uncertain_position(uncertain: tuple[ho.Machine, ho.Log]) -> None:
    """Where bodies are known well, nothing but the position explains the residuals."""
    _, log = uncertain
    problem = ho.identification_problem(arm(stick_exact=False, bodies_within="0.1 %"), [log])
    psi = problem.parameters.nominal
    exact = replace(problem, experiments=tuple(replace(each, position_std=None) for each in problem.experiments))
    (cause,) = examine_fit(ForceReadings(exact, psi)).found
    assert cause.hypothesis.words == "stick.q reads too much"
    assert not examine_fit(ForceReadings(problem, psi)).found


def test_motion_is_fitted_once_whatever_bodies_and_friction_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """And again where the machine's geometry or the readings differ."""
    machine = arm(stick_exact=True)
    log, count = simulated(machine, 5, duration=6.0)[1], []
    fit = misread.examined_fit
    monkeypatch.setattr(module, "examined_fit", lambda problem: count.append(problem) or fit(problem))
    first, again = (module.sensed(each, log) for each in (machine, machine.with_values({"boom.m": 310.0})))
    np.testing.assert_array_equal(first.motion.q, again.motion.q)
    assert len(count) == 1
    module.sensed(machine.with_values({"boom.a": 3.01}), log)
    module.sensed(machine, replace(log, channels={name: x + 1e-6 for name, x in log.channels.items()}))
    assert len(count) == 3


def test_the_check_of_a_log_says_it_before(uncertain: tuple[ho.Machine, ho.Log]) -> None:
    machine, log = uncertain
    less = replace(log, channels={name: x for name, x in log.channels.items() if name != "boom.tau"})
    found = check_logs(machine, [less])
    assert of_kind(found.diagnostics, "uncertain position of a joint taken as exact")
    assert [each.subject for each in of_kind(found.diagnostics, "force not measured in a log")] == [("boom_drive",)]
