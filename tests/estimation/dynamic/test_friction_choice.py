"""Friction terms from logs: every one comes back, and held-out logs tell which of them there are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fixtures.tiers import tiered
from hydroopt.errors import LogError, ProblemError, SolverError
from hydroopt.estimation.dynamic import friction_choice
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.experiment import experiment
from hydroopt.estimation.dynamic.friction_choice import (
    CANDIDATES,
    choose_friction,
    friction_problem,
    with_friction,
)
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Fourier
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, random_truth, simulate

PERIODIC = Fourier(33.28, 20)
TRUE = {"f_coulomb": 900.0, "f_coulomb_reverse": 600.0, "f_viscous": 4000.0, "f_viscous_reverse": 6000.0,
        "f_stribeck": 500.0, "v_stribeck": 0.025, "f_seal": 1e-4}


def crane(**stated: float) -> Machine:
    """The log crane with other friction, of which nothing is known before."""
    data = load_machine("patu655_lift").model_dump()
    data["cylinders"][0]["friction"] = stated
    data["notes"] = {path: note for path, note in data["notes"].items() if ".friction." not in path}
    return Machine.model_validate(data)


def logs_of(machine: Machine, psi: np.ndarray | None = None, *, seeds: tuple[int, ...] = (1, 2, 99),
            noise: bool = False, rate: float = 25.0) -> list[Log]:
    model = Model(machine)
    return [simulate(model, random_trajectory(model, duration=33.28, rate=rate, seed=seed), psi, noise=noise, seed=seed,
                     name=f"motion {seed}") for seed in seeds]


# --- recovery


@pytest.mark.parametrize("method", tiered(["wls", "qp", "sdp", "nlp"], lambda method: method == "sdp"))
@pytest.mark.slow
def test_every_term_comes_back(method: Any) -> None:
    """Nominal friction is zero and the Stribeck speed half of the true one."""
    machine = crane(coulomb=0.0, coulomb_reverse=0.0, viscous=0.0, viscous_reverse=0.0, stribeck=0.0,
                    stribeck_speed=0.0125, seal=0.0)
    truth = random_truth(Model(machine), 3)
    names = Model(machine).parameters
    for name, value in TRUE.items():
        truth[names.index(f"lift_cylinder.{name}")] = value
    logs = logs_of(machine, truth)
    problem = identification_problem(machine, logs[:2], logs[2:], smoothing=PERIODIC)
    estimate = identify(problem, method, tolerance=1e-9, intervals=False)
    assert estimate.fit["validation"]["lift_cylinder"].relative < 1e-9
    for name, value in TRUE.items():
        k = names.index(f"lift_cylinder.{name}")
        assert estimate.psi[k] == pytest.approx(value, rel=1e-6), name
        assert estimate.category(k) == "full", name


@pytest.mark.slow
def test_the_terms_of_every_actuator_of_an_excavator_come_back() -> None:
    data = load_machine("cat215b").model_dump()
    rotary = {"coulomb": 0.0, "stribeck": 0.0, "stribeck_speed": 0.1}
    linear = {"coulomb": 0.0, "stribeck": 0.0, "stribeck_speed": 0.04, "seal": 0.0}
    data["motors"][0]["friction"] = rotary
    for cylinder in data["cylinders"]:
        cylinder["friction"] = linear
        cylinder["barrel"]["body"] = cylinder["rod"]["body"] = None
    data["notes"] = {path: note for path, note in data["notes"].items() if ".friction." not in path}
    for link in data["links"]:
        link["joint"]["friction"] = {}
    machine = Machine.model_validate(data)
    parameters = Model(machine).parameters
    truth = random_truth(Model(machine), 5)
    values = {"tau_coulomb": 9e3, "tau_stribeck": 4e3, "f_coulomb": 5e3, "f_stribeck": 3e3, "f_seal": 5e-4}
    for k, name in enumerate(parameters.names):
        element = name.rpartition(".")[2]
        truth[k] = values.get(element, 1.8 * truth[k] if element == "v_stribeck" else truth[k])
    logs = logs_of(machine, truth, seeds=(1, 2, 3, 99), rate=12.5)
    estimate = identify(identification_problem(machine, logs[:3], logs[3:], smoothing=PERIODIC), "wls", tolerance=1e-9)
    assert max(fit.relative for fit in estimate.fit["validation"].values()) < 1e-9
    told = [k for k, name in enumerate(parameters.names) if name.rpartition(".")[2] in {*values, "v_stribeck"}]
    np.testing.assert_allclose(estimate.psi[told], truth[told], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["huber", "student_t"])
def test_robust_losses_find_stribeck_speeds_too(loss: Any) -> None:
    machine = crane(coulomb=500.0, stribeck=1500.0, stribeck_speed=0.03)
    logs = logs_of(machine, seeds=(1, 2, 3), noise=True, rate=50.0)
    rng = np.random.default_rng(0)
    dirty = [replace(log, channels={c: np.where(rng.random(x.size) < 0.02, 2e7, x) if ".p_" in c else x
                                    for c, x in log.channels.items()}) for log in logs]
    start = crane(coulomb=0.0, stribeck=0.0, stribeck_speed=0.06)
    plain, robust = (identify(identification_problem(start, dirty, smoothing=PERIODIC).with_loss(one), intervals=False)
                     for one in ("squares", loss))
    assert robust["lift_cylinder.v_stribeck"].value == pytest.approx(0.03, rel=0.25)
    assert abs(robust["lift_cylinder.f_stribeck"].value - 1500) < abs(plain["lift_cylinder.f_stribeck"].value - 1500)


@pytest.mark.slow
def test_the_spread_of_stribeck_speeds_is_what_each_estimate_tells() -> None:
    machine = crane(coulomb=500.0, viscous=3000.0, stribeck=1500.0, stribeck_speed=0.03)
    k = Model(machine).parameters.index("lift_cylinder.v_stribeck")
    found = [identify(identification_problem(machine, logs_of(machine, seeds=(2 * seed + 1, 2 * seed + 2), noise=True,
                                                           rate=50.0), smoothing=PERIODIC)) for seed in range(6)]
    values, told = np.array([e.value[k] for e in found]), np.mean([e.std[k] for e in found])
    assert np.std(values, ddof=1) == pytest.approx(told, rel=0.7)
    assert np.mean(values) == pytest.approx(0.03, abs=3 * told / np.sqrt(6))


# --- samples


@pytest.mark.slow
def test_samples_within_a_dead_zone_take_part_where_no_other_friction_is_dry() -> None:
    machine = crane(coulomb=500.0, viscous=3000.0, dead_zone=0.01)
    log = logs_of(machine, seeds=(1,))[0]
    data = experiment(Model(machine), log, PERIODIC)
    q, qd, qdd = data.inputs()
    speed = np.abs(Model(machine).over(Model(machine).cylinder_kinematics, q, qd, qdd)[1][:, 0, 0])
    without = experiment(Model(crane(coulomb=500.0, viscous=3000.0)), log, PERIODIC)
    expected = (speed < 0.01) | without.known[:, 0] & (speed > 0.01)
    clear = np.abs(speed - 0.01) > 1e-6
    np.testing.assert_array_equal(data.known[clear, 0], expected[clear])
    assert np.sum(data.known) > np.sum(without.known)
    pinned = experiment(Model(crane(coulomb=500.0, rod_pin=50.0, dead_zone=0.01)), log, PERIODIC)
    assert not np.any(pinned.known & (speed < 0.01)[:, None])
    # near the ends of the zone noise hides on which side the speed is
    noisy = experiment(Model(machine), logs_of(machine, seeds=(1,), noise=True)[0], PERIODIC)
    assert np.sum(noisy.known) < np.sum(data.known)
    found = identify(identification_problem(machine, [log], smoothing=PERIODIC), "wls")
    assert found["lift_cylinder.f_coulomb"].value == pytest.approx(500.0, rel=1e-6)


def test_pressures_are_inputs_where_seals_feel_them() -> None:
    machine = crane(coulomb=500.0, seal=1e-4)
    log = logs_of(machine, seeds=(1,))[0]
    data = experiment(Model(machine), log, PERIODIC)
    np.testing.assert_array_equal(data.inputs(slice(3))[3][:, 0], sum(
        log.channel(f"lift_cylinder.{end}")[:3] for end in ("p_head", "p_rod")))
    assert experiment(Model(crane(coulomb=500.0)), log, PERIODIC).pressure is None
    force = log.channel("lift_cylinder.p_head") * machine.cylinders[0].areas[0] - (
        log.channel("lift_cylinder.p_rod") * machine.cylinders[0].areas[1])
    direct = replace(log, units={}, channels={"lift.q": log.channel("lift.q"), "lift_cylinder.force": force})
    with pytest.raises(LogError, match=r"no channel 'lift_cylinder\.p_head'"):
        identification_problem(machine, [direct])
    assert np.all(np.isfinite(identification_problem(crane(coulomb=5.0), [direct]).experiments[0].force))


# --- which terms there are


@pytest.mark.parametrize(("text", "place"), [
    ("coulomb+sticky", "'sticky' is not a friction term"), ("", "'' is not a friction term"),
    ("reverse", "'reverse' has no term to change"), ("viscous+dead_zone", "'dead_zone' has no term to change")])
def test_terms_must_be_known_and_have_something_to_change(text: str, place: str) -> None:
    with pytest.raises(ProblemError, match=place):
        with_friction(crane(), text)


def test_stated_values_and_confidences_are_kept_and_all_else_begins_at_zero() -> None:
    file = load_machine("patu655_lift")  # Coulomb 210 ± 2000 N, viscous 330 ± 5000 N·s/m
    machine = with_friction(file, "coulomb+stribeck+reverse+seal", speeds={"lift_cylinder": 0.1})
    stated = machine.cylinders[0].friction
    assert (stated.coulomb, stated.coulomb_reverse, stated.viscous, stated.stribeck) == (210, 210, None, 0)
    assert stated.stribeck_speed == pytest.approx(0.03)
    assert machine.notes["lift_cylinder.friction.coulomb_reverse"].sigma == 2000
    assert "lift_cylinder.friction.viscous" not in machine.notes
    assert with_friction(file, "none").cylinders[0].friction == type(stated)()
    back = with_friction(file, "viscous+coulomb")
    assert back.cylinders == file.cylinders
    assert back.notes == file.notes
    with pytest.raises(ProblemError, match="no cylinders"):
        with_friction(load_machine("ur10"), "coulomb+seal")


def test_offsets_and_pins_stay() -> None:
    file = load_machine("cat215b")
    machine = with_friction(file, "none")
    kept = {name for name in Model(file).parameters.names if not name.endswith(("cylinder.f_coulomb",
                                                                                "motor.tau_coulomb"))}
    assert set(Model(machine).parameters.names) == kept


def chosen(machine: Machine, *, noise: bool = True, candidates: Any = None) -> Estimate:
    logs = logs_of(machine, seeds=(1, 2, 3), noise=noise, rate=50.0)
    return choose_friction(crane(), logs[:2], logs[2:], candidates, intervals=False)


@pytest.fixture(scope="module")
def plain() -> Estimate:
    return chosen(crane(coulomb=500.0, viscous=3000.0))


@pytest.fixture(scope="module")
def sticking() -> Estimate:
    return chosen(crane(coulomb=500.0, viscous=3000.0, stribeck=800.0, stribeck_speed=0.03))


@pytest.mark.slow
def test_what_predicts_is_chosen_not_what_fits(plain: Estimate) -> None:
    choice = plain.friction_choice
    assert choice.terms == "coulomb+viscous"
    rows = {row.terms: row for row in choice.candidates}
    assert list(rows) == list(CANDIDATES)
    assert min(row.training for row in rows.values()) <= rows["coulomb+viscous"].training
    assert rows["viscous"].held_out > rows["coulomb+viscous"].held_out + 3 * rows["viscous"].std
    assert [row.parameters for row in choice.candidates] == [0, 1, 1, 2, 4, 4, 3, 2, 6]
    assert sum(row.chosen for row in choice.candidates) == 1
    assert plain["lift_cylinder.f_coulomb"].value == pytest.approx(500, abs=60)


@pytest.mark.slow
def test_stribeck_is_chosen_where_it_is(sticking: Estimate) -> None:
    assert sticking.friction_choice.terms == "coulomb+viscous+stribeck"
    estimate = sticking
    assert estimate["lift_cylinder.v_stribeck"].value == pytest.approx(0.03, rel=0.3)
    assert estimate.problem.model.machine.cylinders[0].friction.stribeck_speed is not None
    # the calibrated machine has the terms chosen, with their values
    assert estimate.machine.cylinders[0].friction.stribeck == pytest.approx(
        estimate.psi[estimate.problem.parameters.index("lift_cylinder.f_stribeck")])


@pytest.mark.slow
@pytest.mark.parametrize(("truth", "terms"), [
    ({"viscous": 5000.0}, "viscous"), ({"coulomb": 500.0, "viscous": 2000.0, "viscous_reverse": 25000.0},
                                       "coulomb+viscous+reverse"),
    ({"coulomb": 200.0, "viscous": 3000.0, "seal": 2e-4}, "coulomb+viscous+seal")])
def test_other_truths_are_found_too(truth: dict[str, float], terms: str) -> None:
    others = {"none", "coulomb", "viscous", "coulomb+viscous", terms}
    assert chosen(crane(**truth), candidates=sorted(others)).friction_choice.terms == terms


@pytest.mark.slow
def test_the_table_says_what_was_tried_and_why(plain: Estimate) -> None:
    choice = plain.friction_choice
    lines = str(choice).splitlines()
    assert len(lines) == len(CANDIDATES) + 1
    assert [line.split()[1] for line in lines if line.startswith("*")] == ["coulomb+viscous"]
    assert all(row.reason for row in choice.candidates)
    assert f"{choice.blocks} blocks" in choice.rule


def test_nothing_is_chosen_without_held_out_data() -> None:
    with pytest.raises(ProblemError, match=r"no log is held out; give --validate or --holdout"):
        choose_friction(crane(), logs_of(crane(coulomb=1.0), seeds=(1,)), [])


@pytest.mark.slow
def test_seals_are_tried_where_pressures_were_measured() -> None:
    machine = crane(coulomb=500.0)
    logs = []
    for log in logs_of(machine, seeds=(1, 2), noise=True):
        force = log.channel("lift_cylinder.p_head") * machine.cylinders[0].areas[0] - (
            log.channel("lift_cylinder.p_rod") * machine.cylinders[0].areas[1])
        logs.append(replace(log, units={}, channels={"lift.q": log.channel("lift.q"), "lift_cylinder.force": force}))
    choice = choose_friction(machine, logs[:1], logs[1:], intervals=False).friction_choice
    assert [row.terms for row in choice.candidates] == [text for text in CANDIDATES if "seal" not in text]
    with pytest.raises(LogError, match=r"lift_cylinder\.p_head"):
        choose_friction(machine, logs[:1], logs[1:], ["coulomb", "coulomb+seal"], intervals=False)


@pytest.mark.parametrize("speed", tiered([0.01, 0.03, 0.06], lambda speed: speed == 0.01))
@pytest.mark.slow
def test_stribeck_speeds_are_found_from_where_they_begin(speed: float) -> None:
    """Whatever the true one, over the range in which a log shows it."""
    machine = crane(coulomb=500.0, viscous=3000.0, stribeck=2000.0, stribeck_speed=speed)
    logs = logs_of(machine)
    problem = friction_problem(crane(), logs[:2], logs[2:], "coulomb+viscous+stribeck", smoothing=PERIODIC)
    assert identify(problem, intervals=False)["lift_cylinder.v_stribeck"].value == pytest.approx(speed, rel=1e-4)


def test_a_stated_stribeck_speed_stays() -> None:
    machine = crane(stribeck=10.0, stribeck_speed=0.02).model_copy(update={"notes": {
        "lift_cylinder.friction.stribeck_speed": Note(sigma=0.001)}})
    made = with_friction(machine, "coulomb+stribeck")
    assert made.cylinders[0].friction.stribeck_speed == 0.02
    assert made.notes["lift_cylinder.friction.stribeck_speed"].sigma == 0.001


@pytest.mark.slow
def test_a_candidate_that_cannot_be_fitted_is_named_and_not_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(problem: Any, *more: Any, **options: Any) -> Any:
        if not problem.model.linear:
            raise SolverError("it gave up", where="here", remedy="none")
        return identify(problem, *more, **options)

    monkeypatch.setattr(friction_choice, "identify", failing)
    choice = chosen(crane(coulomb=500.0), candidates=["coulomb", "coulomb+stribeck"]).friction_choice
    assert choice is not None
    assert choice.terms == "coulomb"
    assert choice.candidates[1].reason == "not fitted: it gave up"
    assert np.isnan(choice.candidates[1].held_out)


def test_identical_actuators_begin_alike() -> None:
    data = load_machine("cat215b").model_dump()
    data["identical"] = [{"name": "jacks", "friction": ["boom_cylinder", "stick_cylinder"]}]
    boom, stick = with_friction(Machine.model_validate(data), "coulomb+stribeck+dead_zone").cylinders
    assert (boom.friction.dead_zone, boom.friction.stribeck_speed) == (
        stick.friction.dead_zone, stick.friction.stribeck_speed)
