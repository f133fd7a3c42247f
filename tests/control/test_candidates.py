"""Closed loops on the crane with one valve: what must hold whatever the gains."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fixtures.bad_control_cases import PATU
from hydroopt import Model, ProblemError, load_machine, random_trajectory, read_machine
from hydroopt.control.closed_loop import Sensors
from hydroopt.control.comparison import (
    FEEDFORWARD,
    LQG,
    PI,
    SMALL_DB,
    SMALL_DEG,
    Comparison,
    Outcome,
    compare,
    margin_diagnostics,
)
from hydroopt.control.reference import Reference
from hydroopt.control.setting import COMPLETE, NOMINAL, TRUE, ModelVariant, Setting, reduced, truth
from hydroopt.model.plant import Plant
from hydroopt.results.verdict import Action
from hydroopt.simulation.simulate import Trajectory, forces

RATE = 100.0


@pytest.fixture(scope="module")
def setting() -> Setting:
    """A crane with one valve, its oil without the free air that its file states of the rod side."""
    stiff = "\n".join(line for line in PATU.splitlines() if not line.startswith("air_b"))
    plant = Plant(Model(read_machine(stiff)))
    model = plant.model
    motion = random_trajectory(model, duration=14, rate=RATE, seed=1, slowest=0.05, fastest=0.15)
    true = ModelVariant(TRUE, "nominal", model, model.parameters.nominal)
    theta = plant.parameters.nominal
    return Setting(plant, motion, true, theta, theta, RATE, None)


@pytest.fixture(scope="module")
def exact(setting: Setting) -> Comparison:
    """Without noise, with the true parameters and with bodies half as heavy."""
    true = setting.true
    light = np.where([name.endswith((".m", "mc_x", "mc_y", "mc_z")) for name in true.model.parameters.names], 0.5, 1.0)
    return compare(setting, [ModelVariant(NOMINAL, "too light", true.model, light * true.psi),
                             true._replace(name=COMPLETE)])


@pytest.fixture(scope="module")
def exact_feedforward(setting: Setting) -> Comparison:
    """The feedforward alone, on the first two seconds of the motion."""
    path = setting.motion
    short = Trajectory(path.t[:200], path.q[:200], path.qd[:200], path.qdd[:200])
    return compare(replace(setting, motion=short), [setting.true._replace(name=COMPLETE)], [FEEDFORWARD])


def by_name(comparison: Comparison, name: str) -> Outcome:
    return next(outcome for outcome in comparison.outcomes if outcome.name == name)


@pytest.mark.slow
def test_an_exact_model_without_noise_tracks(exact: Comparison) -> None:
    """The tip, whose lever is 7 m long, stays within millimetres of a motion over most of the joint's range."""
    setting, complete = exact.setting, by_name(exact, "feedforward complete")
    assert np.ptp(setting.motion.q) > 0.5
    assert complete.tip_rms < 2.5e-3
    assert complete.tip_rms == pytest.approx(by_name(exact, "feedforward true").tip_rms, rel=1e-9)
    assert by_name(exact, "LQG").tip_rms < 5e-3


@pytest.mark.slow
def test_wrong_bodies_cost_accuracy_and_feedforward_buys_it(exact: Comparison) -> None:
    complete = by_name(exact, "feedforward complete").tip_rms
    assert by_name(exact, "feedforward nominal").tip_rms > 2 * complete
    assert by_name(exact, "PI with gravity compensation").tip_rms > 20 * complete
    assert exact.winner.variant.name != TRUE
    assert exact.winner.tip_rms == min(o.tip_rms for o in exact.outcomes if o.variant.name != TRUE)


@pytest.mark.slow
def test_loops_are_as_robust_as_their_gains_were_tuned_to_be(exact: Comparison) -> None:
    """A sensitivity of M keeps a gain margin of M/(M − 1), and that of its complement, T, a phase margin of 45°."""
    most = exact.setting.sensitivity
    for outcome in exact.outcomes:
        if outcome.kind == LQG:
            continue
        assert len(outcome.margins) == len(exact.points)
        assert min(margin.gain for margin in outcome.margins) > most / (most - 1) * 0.99
        assert min(margin.phase for margin in outcome.margins) > np.radians(45)
        assert min(margin.distance for margin in outcome.margins) > 0.99 / most
        assert min(margin.damping for margin in outcome.margins) > 0


@pytest.mark.slow
def test_energy_is_what_the_moving_chambers_take(exact: Comparison) -> None:
    """Supply pressure times the volume that the growing chamber swept, leaks and compression aside."""
    run, setting = by_name(exact, "feedforward true").run, exact.setting
    plant = setting.plant
    length = np.array([float(plant.actuator_motion(q, 0 * q)[0]) for q in run.q])
    steps, (a, b) = np.diff(length), plant.actuators[0].areas
    swept = np.sum(np.where(steps > 0, a * steps, -b * steps))
    assert run.energy == pytest.approx(plant.supply[0] * swept, rel=0.03)


@pytest.mark.slow
def test_the_seed_decides_the_noise_and_all_candidates_share_it(setting: Setting) -> None:
    path = setting.motion
    noisy = replace(setting, seed=4, motion=Trajectory(path.t[:200], path.q[:200], path.qd[:200], path.qdd[:200]))
    known = [setting.true._replace(name=COMPLETE)]
    first, again = (compare(noisy, known, [FEEDFORWARD]) for _ in range(2))
    complete, true = first.outcomes
    assert_allclose(complete.run.q, true.run.q, rtol=0, atol=0)
    assert_allclose(complete.run.q, again.outcomes[0].run.q, rtol=0, atol=0)
    other = compare(replace(noisy, seed=5), known, [FEEDFORWARD]).outcomes[0]
    assert np.max(np.abs(complete.run.q - other.run.q)) > 1e-6


def test_sensors_err_as_the_file_states_and_add_their_offsets(setting: Setting) -> None:
    plant = setting.plant
    quiet, noisy = (Sensors(plant, np.array([1000.0]), None, 1 / RATE, seed) for seed in (None, 0))
    pressure = np.array([[5e6, 1e6]])
    assert_allclose(quiet.read(0, np.array([0.3]), pressure, 9e6),
                    [0.3, 5e6 + 1000.0 / plant.actuators[0].areas[0], 1e6, 9e6])
    shown = np.array([noisy.read(k, np.array([0.3]), pressure, 9e6) for k in range(4000)])
    sensor = plant.machine.sensor("lift.q")
    assert sensor is not None
    assert np.std(shown[:, 0]) == pytest.approx(sensor.std, rel=0.05)


def test_the_reference_goes_through_its_samples_and_rests_at_its_end() -> None:
    t = np.linspace(0, 2, 21)
    q = np.column_stack([np.sin(3 * t), np.cos(2 * t)])
    path = Reference(Trajectory(t, q, np.column_stack([3 * np.cos(3 * t), -2 * np.sin(2 * t)]),
                                np.column_stack([-9 * np.sin(3 * t), -4 * np.cos(2 * t)])))
    fine = np.linspace(0, 2, 333)
    assert_allclose(path.at(fine).q[:, 0], np.sin(3 * fine), atol=1e-6)
    assert_allclose(path.at(fine).qdd[:-1, 1], -4 * np.cos(2 * fine[:-1]), atol=1e-3)
    after = path.at(np.array([2.5]))
    assert_allclose(after.q[0], q[-1])
    assert not after.qd.any()


def test_the_reduced_model_cannot_come_nearer() -> None:
    """Any other parameters of the reduced model are further from the complete model's forces."""
    model = Model(load_machine("cat215b"))
    nearest = reduced(ModelVariant(COMPLETE, "", model, model.parameters.nominal))
    motion = random_trajectory(model, duration=60.0, rate=5.0, seed=0)
    wanted = forces(model, motion, model.parameters.nominal)
    size = np.sqrt(np.mean(wanted**2, axis=0))

    def off(psi: np.ndarray) -> float:
        return float(np.sum(((forces(nearest.model, motion, psi) - wanted) / size) ** 2))

    least, rng = off(nearest.psi), np.random.default_rng(1)
    start = model.parameters.nominal[list(model.parameters.select(nearest.model.parameters.names))]
    assert least < 0.2 * off(start)
    for _ in range(20):
        step = 1e-3 * rng.standard_normal(len(nearest.psi)) * nearest.model.parameters.scale
        assert off(nearest.psi + step) > least


@pytest.mark.slow
def test_gains_far_too_high_are_refused(setting: Setting) -> None:
    with pytest.raises(ProblemError, match=r"loop of 'lift_cylinder' is unstable .* posture .* gain margin is -\d.*;"):
        compare(replace(setting, gain=60.0), [setting.true._replace(name=COMPLETE)], [PI])


def test_a_truth_of_another_machine_is_refused(setting: Setting, tmp_path) -> None:
    file = tmp_path / "truth.json"
    file.write_text('{"machine": "other", "parameters": {}}')
    with pytest.raises(ProblemError, match="truth of 'other' does not state 'lift"):
        truth(str(file), setting.plant, seed=0)


def test_a_truth_of_driven_valves_is_that_of_the_plant(setting: Setting, tmp_path) -> None:
    plant, file = setting.plant, tmp_path / "truth.json"
    names = [*plant.model.parameters.names, *plant.parameters.names]
    values = np.concatenate([setting.true.psi, 1.1 * plant.parameters.nominal])
    stated = dict(zip(names, values.tolist(), strict=True))
    file.write_text(json.dumps({"machine": "patu655_lift", "parameters": stated}))
    found = truth(str(file), plant, seed=0)
    assert_allclose(found.theta, 1.1 * plant.parameters.nominal)
    assert_allclose(found.variant.psi, setting.true.psi)


def test_less_damping_and_uncertain_valves_are_told(exact_feedforward: Comparison) -> None:
    """Loops with valves known four times as well pass; four times as badly, or if a mode hardly decays, not."""
    best = exact_feedforward.winner
    lost, uncertain = ([each._replace(lost=factor * each.lost) for each in exact_feedforward.lost_margins]
                       for factor in (0.25, 4.0))
    assert {each.loop for each in lost} == {"lift_cylinder"}
    reported = {found.kind for found in margin_diagnostics(best, lost)}
    assert not {"little damping", "margins depend on uncertain valves"} & reported
    (found,) = margin_diagnostics(best, uncertain)
    most = max(uncertain, key=lambda each: each.lost)
    assert (found.kind, found.evidence["parameter"]) == ("margins depend on uncertain valves", most.parameter)
    ringing = replace(best, margins=(*best.margins, best.margins[0]._replace(damping=0.006, damping_at=20.0)))
    (found,) = margin_diagnostics(ringing, lost)
    assert found.kind == "little damping"
    assert "3.2 Hz" in found.text


def test_what_a_valve_takes_from_a_margin_is_what_it_takes_from_the_machine(exact_feedforward: Comparison) -> None:
    """A rated flow larger by one standard deviation: the margin of a machine that has it, computed anew."""
    setting, best = exact_feedforward.setting, exact_feedforward.winner
    plant = setting.plant
    k = plant.parameters.names.index("lift_cylinder.rated_flow")
    larger = setting.theta.copy()
    larger[k] += plant.parameters.scale[k]
    other = compare(replace(setting, true_theta=larger), [setting.true._replace(name=COMPLETE)], [FEEDFORWARD])
    at = [m for m in other.outcomes[0].margins if m.point == best.loops.point]
    (one,) = [each for each in exact_feedforward.lost_margins if each.parameter == "lift_cylinder.rated_flow"]
    assert one.disk == pytest.approx(best.worst("lift_cylinder", "disk", [best.loops.point]).disk, rel=1e-9)
    assert one.disk - one.lost == pytest.approx(at[0].disk, rel=0.02)
    assert one.lost > 0.05


def test_a_joint_follows_a_step_of_its_reference(exact_feedforward: Comparison) -> None:
    t, y = exact_feedforward.winner.loops.steps(30.0)
    assert y[-1, 0] == pytest.approx(1.0, abs=0.03)
    assert t[-1] == pytest.approx(30.0)


def test_small_margins_are_those_that_a_peak_sensitivity_of_two_leaves() -> None:
    """Of a sensitivity M: a gain margin of M/(M − 1), and a phase margin of 2·asin(1/(2·M)), 29 degrees for 2."""
    most = 2.0
    gain, phase = 20 * np.log10(most / (most - 1)), np.degrees(2 * np.arcsin(1 / (2 * most)))
    assert_allclose([gain, phase], [6.02, 28.96], atol=0.01)
    assert_allclose([SMALL_DB, SMALL_DEG], [gain, phase], rtol=0.04)


def test_small_margins_ask_for_the_valves_and_for_more_robust_loops(exact_feedforward: Comparison) -> None:
    assert [each.action for each in exact_feedforward.next_steps] == [Action.USE]
    outcomes = tuple(replace(each, margins=tuple(one._replace(phase=0.4) for one in each.margins))
                     for each in exact_feedforward.outcomes)
    found = replace(exact_feedforward, outcomes=outcomes)
    texts = [each.text for each in found.next_steps]
    assert [text.partition(":")[0] for text in texts] == [
        "Identify valves and oil, since margins depend on them",
        "Loops are slower and more robust with --sensitivity 1.3."]
    careful = replace(found, setting=replace(found.setting, sensitivity=1.3))
    assert [each.text for each in careful.next_steps] == texts[:1]
