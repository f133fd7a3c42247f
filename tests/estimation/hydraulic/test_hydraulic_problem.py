"""Valves and oil from logs of driven machines, and what is refused."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydroopt import Model, load_machine
from hydroopt.errors import IdentifiabilityError, LogError, ProblemError
from hydroopt.estimation.hydraulic.estimate import free_run_fit, identify_hydraulics
from hydroopt.estimation.hydraulic.free_run import free_runs
from hydroopt.estimation.hydraulic.problem import hydraulic_problem
from hydroopt.logs.log import Log
from hydroopt.machine.machine import Machine
from hydroopt.model.plant import Plant
from hydroopt.results.answer import load
from hydroopt.results.diagnostic import of_kind
from hydroopt.simulation.drive_valves import commands_for, drive
from hydroopt.simulation.simulate import Trajectory
from hydroopt.solving import solve

CRANE = Path(__file__).parents[3] / "studies" / "actuator_coverage" / "crane.toml"


def swing(middle: float, size: float, seconds: float, rate: float = 50) -> Trajectory:
    t = np.arange(round(seconds * rate)) / rate
    fade = np.sin(np.pi * t / seconds) ** 2
    q = np.radians(middle) + np.radians(size) * fade * (np.sin(3 * t) + 0.4 * np.sin(9 * t))
    qd = np.gradient(q, t)
    return Trajectory(t, q[:, None], qd[:, None], np.gradient(qd, t)[:, None])


def driven(plant: Plant, motion: Trajectory, **options: Any) -> Log:
    return drive(plant, motion.t, commands_for(plant, motion), motion.q[0], **options)


@pytest.fixture(scope="module")
def crane() -> Plant:
    return Plant(Model(load_machine(str(CRANE))))


@pytest.fixture(scope="module")
def log(crane: Plant) -> Log:
    return driven(crane, swing(30, 5, 4), seed=1)


@pytest.mark.slow
def test_all_of_a_valve_and_its_oil_is_recovered_without_noise(crane: Plant) -> None:
    """With priors that say next to nothing, from a start 20 % off; pressures bend between samples, hence 500 Hz."""
    problem = hydraulic_problem(crane.machine, [driven(crane, swing(30, 5, 4, rate=500), noise=False)])
    known = problem.parameters
    away = np.random.default_rng(3).choice([-0.2, 0.2], len(known))
    moved = replace(known, nominal=known.nominal * (1 + away), information=1e-8 * known.information)
    found = identify_hydraulics(replace(problem, parameters=moved)).adjustment
    assert len(known) == 13
    for name, value, true in zip(known.names, found.theta, known.nominal, strict=True):
        assert value == pytest.approx(true, rel=0.05 if "leakage" in name else 5e-3), name


def test_a_log_is_explained_and_an_unseen_one_predicted(crane: Plant, log: Log) -> None:
    estimate = identify_hydraulics(hydraulic_problem(crane.machine, [log], [driven(crane, swing(40, 3, 3), seed=2)]))
    assert np.all(np.abs(estimate.adjustment.misfit - 1) < 0.15)
    known, found = estimate.problem.parameters, estimate.adjustment
    assert np.all(np.abs(found.theta - known.nominal) < 4 * np.sqrt(np.diag(found.covariance)))
    unseen = estimate.fit["validation"]
    assert unseen["jack.length"].largest < 5e-3
    assert unseen["jack.p_head"].of_range < 0.05
    written = estimate.machine
    assert written.oil.bulk_modulus == estimate["oil.bulk_modulus"].value
    assert written.circuits["jack"].valve.dead_band == estimate["jack.dead_band"].value
    assert written.notes["jack.circuit.valve.dead_band"].sigma == pytest.approx(
        found.std[known.index("jack.dead_band")])


def test_neither_bodies_nor_friction_have_a_part_in_it(crane: Plant, log: Log) -> None:
    """The same numbers to the last digit by a machine file that is wrong about them."""
    heavy = CRANE.read_text().replace('m = "490 kg"', 'm = "900 kg"').replace('"1500 N"', '"20000 N"')
    right, wrong = (identify_hydraulics(hydraulic_problem(machine, [log])) for machine in (
        crane.machine, _machine(heavy)))
    assert right.adjustment.theta.tolist() == wrong.adjustment.theta.tolist()
    assert not [name for name in right.parameters if ".f_" in name]


@pytest.mark.slow
def test_directions_that_differ_are_found_and_missed_where_the_file_has_one_number(crane: Plant) -> None:
    """Edges 14 % apart are told where each states its own σ, and named where one stands for all."""
    truth = crane.parameters.nominal.copy()
    for name, factor in (("flow_pa", 1.07), ("flow_bt", 1.07), ("flow_pb", 0.93), ("flow_at", 0.93)):
        truth[crane.parameters.index(f"jack.{name}")] *= factor
    log = driven(crane, swing(30, 5, 6), theta=truth, seed=4)
    apart = identify_hydraulics(hydraulic_problem(crane.machine, [log]))
    for name in ("flow_pa", "flow_bt", "flow_pb", "flow_at"):
        found = apart[f"jack.{name}"]
        assert abs(found.value - truth[crane.parameters.index(f"jack.{name}")]) < 3.5 * found.std < 0.1 * found.value
    text = CRANE.read_text()
    a, b = text.index("flow_pa"), text.index("rated_drop")
    one = _machine(text[:a] + 'rated_flow = { value = "66 L/min", sigma = "20 %" }\n' + text[b:])
    together = identify_hydraulics(hydraulic_problem(one, [log]))
    (said,) = of_kind(together.diagnostics, "flow not explained by the model")
    assert said.subject == ("jack",)
    assert together.adjustment.density[0] > 3 * apart.adjustment.density[0]


def test_a_dead_band_that_is_never_left_is_refused(crane: Plant, log: Log) -> None:
    with pytest.raises(IdentifiabilityError, match="never leaves the dead band"):
        hydraulic_problem(crane.machine, [_with(log, "jack.u", np.full(log.size, 5.6))])


def test_a_missing_command_is_refused_by_name(crane: Plant, log: Log) -> None:
    with pytest.raises(LogError, match=r"no channel 'jack\.u'"):
        hydraulic_problem(crane.machine, [_without(log, "jack.u")])


def test_an_unknown_supply_is_refused(log: Log) -> None:
    machine = _machine(CRANE.read_text().replace('pressure = "180 bar"\n', ""))
    assert len(hydraulic_problem(machine, [log]).balanced) == 1
    with pytest.raises(ProblemError, match="supply's pressure is not known"):
        _ = hydraulic_problem(machine, [_without(log, "pump.p_supply")]).balanced


def test_a_log_shorter_than_a_spools_own_motion_is_refused(crane: Plant, log: Log) -> None:
    with pytest.raises(LogError, match="no part without a gap is longer than the spools' own motion"):
        _ = hydraulic_problem(crane.machine, [log.slice(0, 5)]).balanced


def test_a_machine_without_circuits_or_doubts_is_refused(log: Log) -> None:
    head, _, tail = CRANE.read_text().partition("[cylinders.circuit]")
    with pytest.raises(ProblemError, match="no circuit is stated for"):
        hydraulic_problem(_machine(head + "[[sensors]]" + tail.partition("[[sensors]]")[2]), [log])
    exact = CRANE.read_text()
    while ", sigma" in exact:
        head, _, tail = exact.partition(", sigma")
        exact = head + tail[tail.index("}") - 1 :]
    with pytest.raises(ProblemError, match="nothing is identified"):
        hydraulic_problem(_machine(exact), [log])


def test_free_runs_are_judged_by_what_was_read(crane: Plant, log: Log) -> None:
    estimate = identify_hydraulics(hydraulic_problem(crane.machine, [log]))
    (run,) = estimate.runs["train"]
    shifted = replace(run, outputs=run.y + np.array([0.0, 0.002, 0.0, 0.0]))
    fit = free_run_fit(estimate.problem, [shifted])["jack.length"]
    assert fit.rms == pytest.approx(0.002)
    assert fit.of_range == pytest.approx(0.002 / np.ptp(run.y[:, 1]))


def test_a_free_run_without_noise_is_the_log(crane: Plant) -> None:
    log = driven(crane, swing(30, 5, 4), noise=False)
    estimate = identify_hydraulics(hydraulic_problem(crane.machine, [log]))
    known = estimate.problem.parameters.nominal
    exact = replace(estimate, adjustment=replace(estimate.adjustment, theta=known))
    (run,) = exact.runs["train"]
    assert np.max(np.abs(run.outputs[:, 1] - log.channels["jack.length"])) < 1e-4


def test_an_estimate_is_loaded_as_it_was_saved(crane: Plant, log: Log, tmp_path: Path) -> None:
    estimate = solve(hydraulic_problem(crane.machine, [log]))
    estimate.save(tmp_path)
    loaded = load(tmp_path)
    assert repr(loaded) == repr(estimate)
    assert str(loaded) == str(estimate)
    assert loaded.parameters == estimate.parameters
    assert loaded.diagnostics == estimate.diagnostics
    assert loaded.fit == estimate.fit
    assert loaded.details() == estimate.details()
    assert loaded["jack.dead_band"].value == estimate["jack.dead_band"].value
    assert estimate["jack.dead_band"].value == estimate.adjustment["jack.dead_band"]
    assert loaded.machine.oil.bulk_modulus == pytest.approx(loaded["oil.bulk_modulus"].value)


def _machine(text: str) -> Machine:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "crane.toml"
        path.write_text(text)
        return load_machine(str(path))


def _with(log: Log, channel: str, values: np.ndarray) -> Log:
    return replace(log, channels={**log.channels, channel: values})


def _without(log: Log, channel: str) -> Log:
    return replace(log, channels={name: x for name, x in log.channels.items() if name != channel})


def test_a_free_run_that_begins_in_motion_begins_at_the_right_speed() -> None:
    """By the true numbers: the speed of a smoothed motion at the end of a log moved pressures by 4 bar."""
    plant = Plant(Model(load_machine("patu655_lift")))
    t = np.arange(600) / 100
    u = 5.7 + 1.2 * np.sin(2 * np.pi * 0.25 * t)
    clean = drive(plant, t, u[:, None], np.array([0.5]), noise=False)
    rest = drive(plant, t, u[:, None], np.array([0.5]), seed=4).slice(300, 600)
    problem = hydraulic_problem(plant.machine, [rest])
    (run,) = free_runs(problem, rest, problem.parameters.nominal)
    for channel in ("lift_cylinder.p_head", "lift_cylinder.p_rod"):
        error = run.outputs[:, problem.channels.index(channel)] - clean.channels[channel][300:]
        assert np.sqrt(np.mean(error[:100] ** 2)) < 1e5
