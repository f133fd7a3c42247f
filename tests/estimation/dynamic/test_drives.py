"""Bodies and friction of machines with several, unmeasured or no actuators on a joint come back from exact logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fixtures import springs
from fixtures.drives import crane, crossing
from fixtures.tiers import tiered
from hydroopt.estimation.dynamic.experiment import Experiment, experiment
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.misfit.hypotheses import Scaled, listed
from hydroopt.estimation.dynamic.misfit.naming import examine_fit
from hydroopt.estimation.dynamic.misfit.readings import ForceReadings
from hydroopt.estimation.dynamic.misfit.view import View
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.inference.identifiability import structural
from hydroopt.logs.forces_from_pressures import force_noise, forces
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.simulation.passive_joints import passive_motion
from hydroopt.simulation.simulate import random_trajectory, random_truth, simulate

MACHINES = {"one of two not measured, and a passive joint": lambda: crane("swing_right"),
            "alone and not measured": lambda: crane("boom_right", "reach"), "across two joints": crossing,
            "springs": springs.crane}


def exact(model: Model, psi: np.ndarray, seed: int) -> Experiment:
    """An experiment without noise and with the motion that was simulated, whose forces agree with its log."""
    motion = random_trajectory(model, duration=10.0, rate=20.0, seed=seed)
    q, qd, qdd = passive_motion(model, motion.t, (motion.q, motion.qd, motion.qdd), psi)
    log = simulate(model, replace(motion, q=q, qd=qd, qdd=qdd), psi, noise=False)
    made, every = experiment(model, log), np.ones(len(q), dtype=bool)
    made = replace(made, motion=replace(made.motion, q=q, qd=qd, qdd=qdd, interior=every),
                   known=np.ones_like(made.known), calm=None)
    predicted, read = made.predicted(psi), forces(model, log, q)
    assert np.max(np.abs(read - predicted)) < 1e-8 * np.max(np.abs(read))  # passive joints are integrated to 1e-10
    return replace(made, force=np.where(np.any(read != 0, axis=0), predicted, read))


@pytest.mark.parametrize("name", tiered(MACHINES, lambda name: name == "across two joints"))
def test_exact_logs_give_the_truth(name: str) -> None:
    model = Model(MACHINES[name](), actuator_inertia=False)  # barrels and rods side by side are hard to tell apart
    rng, truth = np.random.default_rng(5), model.parameters.nominal.copy()
    for block in model.parameters.bodies.values():
        truth[block] *= rng.uniform(0.7, 1.4)
    friction = [not kind.is_inertial for kind in model.parameters.kinds]
    truth[friction] *= rng.uniform(0.5, 1.5, sum(friction))
    train, seen = (tuple(exact(model, truth, seed) for seed in seeds) for seeds in ((1, 2), (99,)))
    problem = IdentificationProblem(model, train, seen, force_noise(model))
    found = identify(problem, "wls", tolerance=1e-9, intervals=False)
    assert max(fit.rms for fit in found.fit["validation"].values()) < 1e-7 * np.max(np.abs(seen[0].force))
    structure = structural(model)
    base = structure.grouping @ truth
    np.testing.assert_allclose(structure.grouping @ found.psi, base, rtol=1e-6, atol=1e-9 * np.max(np.abs(base)))
    unmeasured = [each.name for each in model.machine.actuators if each not in model.machine.measured_actuators]
    for own, kind, category in zip(model.parameters.names, model.parameters.kinds, structure.category, strict=True):
        if kind is ParameterKind.VISCOUS_FRICTION and own.partition(".")[0] in unmeasured:
            assert category == "none"


def test_noise_of_a_balance_follows_from_its_actuators_lever_arms() -> None:
    machine = crane()
    model = Model(machine)
    swing, boom, reach, grapple = force_noise(model)
    a, b = machine.cylinders[0].areas
    one = float(np.hypot(a, b) * machine.sensors[1].std)
    assert reach == pytest.approx(one)
    assert np.isnan(grapple)
    q = np.random.default_rng(1).uniform(*machine.ranges.T, (4000, 4))
    arms = model.over(model.transmission, q)[0]
    for k, sigma in ((0, swing), (1, boom)):
        assert sigma == pytest.approx(one * np.sqrt(np.mean(np.sum(arms[:, :, k] ** 2, axis=1))), rel=0.05)


@pytest.mark.slow
def test_what_nothing_reads_has_neither_spikes_nor_a_signal_that_is_missed() -> None:
    model = Model(crane(), actuator_inertia=False)
    logs = [simulate(model, random_trajectory(model, duration=10.0, rate=50.0, seed=seed), model.parameters.nominal,
                     seed=seed) for seed in (1, 2)]
    found = identify(identification_problem(model, logs[:1], logs[1:]), intervals=False)
    assert found.misfit
    assert found.misfit.spikes["grapple"] == 0
    assert "grapple" not in found.misfit.lines
    assert not [one for one in found.diagnostics if one.kind == "validation forces predicted worse than by zero"]
    assert "nan" not in str(found)


@pytest.mark.slow
def test_a_grapple_that_swings_is_not_accused_and_its_late_angle_is_named() -> None:
    """Its balance has no reading, only errors of angles, whose covariance is not known to the last digit."""
    model = Model(load_machine("forestry_crane"))
    for seed, truth in ((1, random_truth(model, 1)), (4, random_truth(model, 4))):
        log = simulate(model, random_trajectory(model, duration=33.28, rate=100.0, seed=seed), truth, seed=seed)
        late = replace(log, channels={**log.channels, "sway.q": np.interp(
            log.t - 0.01, log.t, log.channels["sway.q"])})
        sound, found = (examine_fit(ForceReadings(identification_problem(model, [each]), truth))
                        for each in (log, late))
        assert not sound.unexplained
        assert [cause.hypothesis.name for cause in found.found] == ["delay sway.q"]
        assert found.found[0].size == pytest.approx(0.01, abs=0.002)
        assert not any(fault.subject in (("swing",), ("sway",)) for fault in sound.smallest if fault.group == "delay")


def test_a_pressure_that_reads_too_much_is_searched_for_at_shared_joints() -> None:
    """Its effect is what scaling the channel does to the balance, by lever arms that change along the motion."""
    model = Model(crossing())
    log = simulate(model, random_trajectory(model, duration=10.0, rate=20.0, seed=1), noise=False)
    view = View.of(experiment(model, log), model.parameters.nominal)
    gains = {fault.subject[0]: fault for fault in listed(view) if isinstance(fault, Scaled)}
    assert set(gains) == {channel for cylinder in model.machine.cylinders for channel in cylinder.chambers}
    q = view.motion.q
    for channel, fault in gains.items():
        more = replace(log, channels={**log.channels, channel: 1.1 * log.channels[channel]})
        changed = forces(model, more, q) - forces(model, log, q)
        found = fault.effect(view, 0.1)[:, : changed.shape[1]]
        assert np.linalg.norm(found - changed) < 0.05 * np.linalg.norm(changed), "but for what is low-passed"


@pytest.mark.slow
def test_a_pressure_that_reads_too_much_is_named_at_a_shared_joint() -> None:
    model = Model(load_machine("backhoe"))
    log = simulate(model, random_trajectory(model, duration=33.28, rate=50.0, seed=1), random_truth(model, 3), seed=1)
    channel = "swing_cylinder_left.p_head"
    wrong = replace(log, channels={**log.channels, channel: 1.2 * log.channels[channel]})
    sound, found = (identify(identification_problem(model, [each]), intervals=False) for each in (log, wrong))
    assert sound.status == "ok"
    assert found.status == "suspect"
    cause = found.misfit.found[0]
    assert cause.hypothesis.subject == (channel,)
    assert abs(cause.size - 0.2) < 3 * cause.std
