"""Valves, oil and friction from logs of driven machines, and what is refused."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from hydroopt import Model, load_machine
from hydroopt.errors import IdentifiabilityError, LogError, ProblemError
from hydroopt.estimation.hydraulic import shooting
from hydroopt.estimation.hydraulic.estimate import free_run_fit, identify_hydraulics
from hydroopt.estimation.hydraulic.problem import hydraulic_problem
from hydroopt.estimation.hydraulic.shooting import multiple_shooting
from hydroopt.model.plant import Plant
from hydroopt.results.answer import load
from hydroopt.simulation.drive_valves import commands_for, drive
from hydroopt.simulation.simulate import Trajectory
from hydroopt.solving import solve

CRANE = Path(__file__).parents[3] / "studies" / "actuator_coverage" / "crane.toml"


def swing(middle, size, seconds, rate=50):
    t = np.arange(round(seconds * rate)) / rate
    fade = np.sin(np.pi * t / seconds) ** 2
    q = np.radians(middle) + np.radians(size) * fade * (np.sin(3 * t) + 0.4 * np.sin(9 * t))
    qd = np.gradient(q, t)
    return Trajectory(t, q[:, None], qd[:, None], np.gradient(qd, t)[:, None])


def driven(plant, motion, **options):
    return drive(plant, motion.t, commands_for(plant, motion), motion.q[0], **options)


@pytest.fixture(scope="module")
def crane():
    return Plant(Model(load_machine(str(CRANE))))


@pytest.fixture(scope="module")
def log(crane):
    return driven(crane, swing(30, 5, 4), seed=1)


def without_noise(plant, motion, off, steps):
    """Parameters found from a log without noise, from a start that is `off` their true values, and these."""
    problem = hydraulic_problem(plant.machine, [driven(plant, motion, noise=False)], steps=steps)
    known = problem.parameters
    away = np.random.default_rng(3).choice([-off, off], len(known))
    moved = replace(known, nominal=known.nominal * (1 + away), information=1e-8 * known.information)
    return shooting.multiple_shooting(replace(problem.shooting, parameters=moved)), known


@pytest.mark.slow
def test_all_of_a_valve_and_its_oil_is_recovered():
    """Without dry friction, which turns round within a part of a sample that no collocation follows to 1e-4."""
    smooth = _machine(CRANE.read_text().replace('value = "1500 N"', 'value = "0 N"'))
    found, known = without_noise(Plant(Model(smooth)), swing(30, 5, 4), 0.25, steps=3)
    hydraulic = [k for k, name in enumerate(known.names) if not name.startswith("jack.f_")]
    assert len(hydraulic) == 13
    np.testing.assert_allclose(found.theta[hydraulic], known.nominal[hydraulic], rtol=1e-4)


@pytest.mark.slow
def test_the_lift_of_the_log_crane_is_recovered():
    plant = Plant(Model(load_machine("patu655_lift")))
    found, known = without_noise(plant, swing(20, 2, 4), 0.25, steps=2)
    names = [f"lift_cylinder.{key}" for key in ("rated_flow", "dead_band", "volume_a")]
    for k in known.select(names):
        assert found.theta[k] == pytest.approx(known.nominal[k], rel=1e-4)


def test_a_log_is_explained_and_an_unseen_one_predicted(crane, log):
    estimate = identify_hydraulics(hydraulic_problem(crane.machine, [log], [driven(crane, swing(40, 3, 3), seed=2)]))
    assert np.all(np.abs(estimate.misfit - 1) < 0.15)
    known = estimate.problem.parameters
    assert np.all(np.abs(estimate.shooting.theta - known.nominal) < 4 * np.sqrt(np.diag(estimate.shooting.covariance)))
    unseen = estimate.fit["validation"]
    assert unseen["jack.length"].largest < 3e-3
    assert unseen["jack.p_head"].of_range < 0.03
    written = estimate.machine
    assert written.oil.bulk_modulus == estimate["oil.bulk_modulus"].value
    assert written.circuits["jack"].valve.dead_band == estimate["jack.dead_band"].value
    assert written.notes["jack.circuit.valve.dead_band"].sigma == pytest.approx(
        estimate.shooting.std[known.index("jack.dead_band")])


@pytest.mark.slow
def test_bodies_are_found_as_far_as_forces_show_them(crane):
    text = CRANE.read_text().replace('m = "490 kg"', 'm = { value = "490 kg", sigma = "10 %" }')
    psi = crane.model.parameters.nominal.copy()
    psi[crane.model.parameters.select(["lift.m", "lift.mc_x", "lift.mc_y"])] *= 1.1
    heavy = driven(crane, swing(30, 5, 3), psi=psi, seed=1)
    problem = hydraulic_problem(_machine(text), [heavy], bodies=True)
    assert problem.bodies.shape[1] == 3  # two of gravity, one of inertia
    assert problem.held_bodies == ()
    estimate = identify_hydraulics(problem)
    found = np.asarray(problem.split(estimate.shooting.theta)[0]).ravel()
    k = crane.model.parameters.index("lift.mc_x")
    assert found[k] == pytest.approx(psi[k], rel=0.03)
    assert np.all(estimate.misfit < 1.15)
    body = estimate.machine.link("lift").body
    assert body.phi[1] == pytest.approx(found[k])


def test_bodies_that_are_held_exact_in_spite_of_their_confidences_are_named(crane, log):
    assert hydraulic_problem(crane.machine, [log]).held_bodies == ("lift",)
    assert hydraulic_problem(crane.machine, [log], bodies=True).held_bodies == ()


def test_a_dead_band_that_is_never_left_is_refused(crane, log):
    with pytest.raises(IdentifiabilityError, match="never leaves the dead band"):
        hydraulic_problem(crane.machine, [_with(log, "jack.u", np.full(log.size, 5.6))])


def test_a_missing_command_is_refused_by_name(crane, log):
    with pytest.raises(LogError, match=r"no channel 'jack\.u'"):
        hydraulic_problem(crane.machine, [_without(log, "jack.u")])


def test_an_unknown_supply_is_refused(log):
    machine = _machine(CRANE.read_text().replace('pressure = "180 bar"\n', ""))
    assert len(hydraulic_problem(machine, [log]).shooting.records) == 1
    with pytest.raises(ProblemError, match="supply's pressure is not known"):
        _ = hydraulic_problem(machine, [_without(log, "pump.p_supply")]).shooting


def test_a_machine_without_circuits_or_doubts_is_refused(log):
    head, _, tail = CRANE.read_text().partition("[cylinders.circuit]")
    with pytest.raises(ProblemError, match="no circuit is stated for"):
        hydraulic_problem(_machine(head + "[[sensors]]" + tail.partition("[[sensors]]")[2]), [log])
    exact = CRANE.read_text()
    while ", sigma" in exact:
        head, _, tail = exact.partition(", sigma")
        exact = head + tail[tail.index("}") - 1 :]
    with pytest.raises(ProblemError, match="nothing is identified"):
        hydraulic_problem(_machine(exact), [log])


@pytest.mark.slow
def test_free_runs_are_judged_by_what_was_read(crane, log):
    problem = hydraulic_problem(crane.machine, [log])
    record = problem.records(log)[0]
    estimate = identify_hydraulics(problem)
    run = estimate.run(record, estimate.shooting.solution.points[0][0])
    shifted = replace(run, outputs=record.y + np.array([0.0, 0.002, 0.0, 0.0]))
    fit = free_run_fit(problem, [shifted])["jack.length"]
    assert fit.rms == pytest.approx(0.002)
    assert fit.of_range == pytest.approx(0.002 / np.ptp(record.y[:, 1]))


def _machine(text):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "crane.toml"
        path.write_text(text)
        return load_machine(str(path))


def _with(log, channel, values):
    return replace(log, channels={**log.channels, channel: values})


def _without(log, channel):
    return replace(log, channels={name: x for name, x in log.channels.items() if name != channel})


@pytest.mark.slow
def test_the_problem_prints_itself_and_ipopt_finds_the_same_optimum(crane):
    """By the program that the user gets, with derivatives by CasADi, against the first of our two solves."""
    problem = hydraulic_problem(crane.machine, [driven(crane, swing(30, 3, 1), seed=1)])
    text = str(problem)
    for part in ("variables x", "jack.dead_band", "minimise f", "residuals of jack.p_head", "subject to g",
                 "dynamics of lift.q"):
        assert part in text
    assert len(repr(problem)) < 100
    program = problem.nlp()
    assert program["oil.bulk_modulus"].numel() == 1
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9,
               "ipopt.nlp_scaling_method": "none"}
    answer = ca.nlpsol("by_hand", "ipopt", program.as_dict(), options)(**program.arguments())
    first = multiple_shooting(problem.shooting)
    objective = np.sum(first.solution.rows**2) / 2
    assert float(answer["f"]) == pytest.approx(objective, rel=1e-9)
    parameters = problem.parameters
    found = parameters.nominal + parameters.scale * np.asarray(answer["x"]).ravel()[: len(parameters)]
    np.testing.assert_allclose(found / first.theta, 1.0, rtol=1e-5)
    louder = problem.nlp(sigma=2 * problem.sigma)
    value = ca.Function("f", [louder.x], [louder.f])(answer["x"])
    assert float(value) < objective / 2
    with pytest.raises(ProblemError, match="not convex"):
        problem.cvxpy()


@pytest.mark.slow
def test_an_estimate_is_loaded_as_it_was_saved(crane, log, tmp_path):
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
    assert estimate["jack.dead_band"].value == estimate.shooting["jack.dead_band"]
    assert load_machine(loaded.machine_file).oil.bulk_modulus == pytest.approx(loaded["oil.bulk_modulus"].value)
