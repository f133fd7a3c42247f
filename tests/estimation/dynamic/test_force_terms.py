"""Force terms of a user's own: against forces computed by NumPy, and recovered with intervals that hold the truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import hydroopt as ho
from fixtures.periodic import PERIOD, PERIODIC
from hydroopt.simulation.simulate import Trajectory

CYLINDER = "lift_cylinder"
TRUE_STIFFNESS, TRUE_DRAG, SPEED = 8e3, 900.0, 0.02


def spring(x: Any, p: Any) -> Any:
    """A hose that pulls like a spring, and drag that saturates over a known speed."""
    return p["k_hose"] * (x.position - 2.0) + p["drag"] * ca.tanh(x.speed / SPEED)


LINEAR = ho.ForceTerm(CYLINDER, {"k_hose": ho.Coefficient("N/m", sigma=2e4), "drag": ho.Coefficient("N", sigma=3e3)},
                      spring)
CURVED = ho.ForceTerm(CYLINDER, {"drag": ho.Coefficient("N", 500.0, sigma=3e3, lower=0.0),
                                 "v_0": ho.Coefficient("m/s", 0.04, sigma=0.05, lower=0.005, upper=1.0)},
                      lambda x, p: p["drag"] * ca.tanh(x.speed / p["v_0"]))


@pytest.fixture(scope="module")
def machine() -> ho.Machine:
    return ho.load_machine("patu655_lift")


@pytest.fixture(scope="module")
def motion(machine: ho.Machine) -> Trajectory:
    return ho.random_trajectory(ho.Model(machine), duration=PERIOD, rate=50, seed=3)


def by_numpy(plain: ho.Model, motion: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forces (N,) of the machine without the term, and length and speed of the cylinder, whose geometry is a triangle:
    the speed is the length's derivative by finite differences."""
    force = ho.simulate(plain, motion, plain.parameters.nominal, noise=False)
    lengths = plain.triangles[CYLINDER][0]
    step = 1e-6
    length, ahead, behind = (np.array(lengths(motion.q[:, 0] + shift)).ravel() for shift in (0, step, -step))
    return force.t, length, (ahead - behind) / (2 * step) * motion.qd[:, 0]


def test_the_term_is_in_all_predicted_forces(machine: ho.Machine, motion: Trajectory) -> None:
    plain, model = ho.Model(machine), ho.Model(machine, terms=[LINEAR])
    _, length, speed = by_numpy(plain, motion)
    psi = model.parameters.nominal.copy()
    psi[model.parameters.select([f"{CYLINDER}.k_hose", f"{CYLINDER}.drag"])] = TRUE_STIFFNESS, TRUE_DRAG
    state = (motion.q, motion.qd, motion.qdd)
    expected = (plain.over(plain.inverse_dynamics, *state, plain.parameters.nominal)[0][:, 0, 0]
                + TRUE_STIFFNESS * (length - 2.0) + TRUE_DRAG * np.tanh(speed / SPEED))
    scale = np.max(np.abs(expected))
    for found in (model.over(model.inverse_dynamics, *state, psi)[0][:, 0, 0],
                  (model.over(model.regressor, *state)[0] @ psi)[:, 0],
                  model.over(model.actuator_forces, *state, np.zeros((len(motion.t), 1)), psi)[0][:, 0, 0]):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * scale)
    assert model.linear
    assert not ho.Model(machine, terms=[CURVED]).linear


@pytest.mark.parametrize("method", ["wls", "sdp"])
def test_linear_coefficients_are_recovered_without_noise(machine: ho.Machine, motion: Trajectory, method: str) -> None:
    model = ho.Model(machine, terms=[LINEAR])
    psi = model.parameters.nominal.copy()
    psi[model.parameters.select([f"{CYLINDER}.k_hose", f"{CYLINDER}.drag"])] = TRUE_STIFFNESS, TRUE_DRAG
    log = ho.simulate(model, motion, psi, noise=False)
    estimate = ho.solve(ho.identification_problem(model, [log], smoothing=PERIODIC), method, seed=1)
    drag = estimate[f"{CYLINDER}.drag"]
    assert drag.unit == "N"
    assert drag.kind == "coefficient"
    assert drag.value == pytest.approx(TRUE_DRAG, rel=0.001)
    assert estimate.fit["train"]["all"].vaf > 0.9999
    without = ho.solve(ho.identification_problem(machine, [log], smoothing=PERIODIC), method, seed=1)
    assert without.fit["train"]["all"].rms > 5 * estimate.fit["train"]["all"].rms


def test_coefficients_that_enter_nonlinearly_are_recovered_by_gauss_newton(machine: ho.Machine,
                                                                           motion: Trajectory) -> None:
    model = ho.Model(machine, terms=[CURVED])
    psi = model.parameters.nominal.copy()
    psi[model.parameters.select([f"{CYLINDER}.drag", f"{CYLINDER}.v_0"])] = TRUE_DRAG, SPEED
    log = ho.simulate(model, motion, psi, noise=False)
    estimate = ho.solve(ho.identification_problem(model, [log], smoothing=PERIODIC), "qp", seed=1)
    assert estimate[f"{CYLINDER}.drag"].value == pytest.approx(TRUE_DRAG, rel=0.002)
    assert estimate[f"{CYLINDER}.v_0"].value == pytest.approx(SPEED, rel=0.002)
    assert model.nonlinear.sum() == 2


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say(machine: ho.Machine) -> None:
    model = ho.Model(machine, terms=[LINEAR])
    names = [f"{CYLINDER}.k_hose", f"{CYLINDER}.drag"]
    places, inside, tries = model.parameters.select(names), 0, 40
    rng = np.random.default_rng(5)
    for seed in range(tries):
        psi = ho.random_truth(model, seed=seed)
        psi[places] = rng.normal(size=2) * [2e4, 3e3]
        motion = ho.random_trajectory(model, duration=30, rate=25, seed=seed)
        estimate = ho.solve(ho.identification_problem(model, [ho.simulate(model, motion, psi, seed=seed)]), seed=seed)
        for name, k in zip(names, places, strict=True):
            low, high = estimate[name].ci95
            inside += low <= psi[k] <= high
    # 2 · 40 intervals at 95 %: fewer than 69 inside has a probability below 1 %
    assert inside >= 69


def test_a_term_of_pressures_is_identified_from_forces_that_a_formula_made(machine: ho.Machine,
                                                                           motion: Trajectory) -> None:
    """Pressures solve the balance head·p_head − rod·p_rod = force + share·(p_head + p_rod) by hand."""
    plain = ho.Model(machine)
    log = ho.simulate(plain, motion, noise=False)
    head, rod = next(each for each in machine.cylinders if each.name == CYLINDER).areas
    force = head * log.channels[f"{CYLINDER}.p_head"] - rod * log.channels[f"{CYLINDER}.p_rod"]
    share, p_rod = 2e-4, 5e6 + 3e6 * np.sin(1.7 * log.t)  # back pressure that the force does not tell
    p_head = (force + (rod + share) * p_rod) / (head - share)
    made = replace(log, channels={**log.channels, f"{CYLINDER}.p_head": p_head, f"{CYLINDER}.p_rod": p_rod})
    term = ho.ForceTerm(CYLINDER, {"share": ho.Coefficient("m^2", sigma=1e-3)},
                        lambda x, p: p["share"] * x.pressure)
    model = ho.Model(machine, terms=[term])
    assert model.needs_pressure
    estimate = ho.solve(ho.identification_problem(model, [made], smoothing=PERIODIC), seed=1)
    assert estimate[f"{CYLINDER}.share"].value == pytest.approx(share, rel=0.001)
    with pytest.raises(ho.ProblemError, match="depend on pressures"):
        ho.simulate(model, motion)


def test_constraints_and_priors_take_the_coefficients(machine: ho.Machine, motion: Trajectory) -> None:
    model = ho.Model(machine, terms=[LINEAR])
    log = ho.simulate(model, motion, seed=1)
    problem = ho.identification_problem(model, [log])
    held = ho.solve(problem.subject_to("hose", lambda p: p[f"{CYLINDER}.k_hose"] == 1234.0), seed=1)
    assert held[f"{CYLINDER}.k_hose"].value == pytest.approx(1234.0, rel=1e-6)
    fixed = ho.solve(problem.fix(f"{CYLINDER}.drag", 77.0), seed=1)
    assert fixed[f"{CYLINDER}.drag"].value == pytest.approx(77.0)


def test_no_machine_file_pretends_to_hold_the_term(machine: ho.Machine, motion: Trajectory, tmp_path: Any) -> None:
    model = ho.Model(machine, terms=[LINEAR])
    estimate = ho.solve(ho.identification_problem(model, [ho.simulate(model, motion, seed=1)]), seed=1)
    with pytest.raises(ho.ProblemError, match=r"cannot state force terms of the user's own: lift_cylinder\.k_hose"):
        _ = estimate.machine
    estimate.save(tmp_path / "out")
    assert not (tmp_path / "out/patu655_lift.toml").exists()
    loaded = ho.load(tmp_path / "out")
    assert loaded[f"{CYLINDER}.drag"].value == estimate[f"{CYLINDER}.drag"].value
    assert "no calibrated machine" in {str(each.kind) for each in loaded.diagnostics}


ONE = {"a": ho.Coefficient("N")}
BAD = {
    "unknown actuator": (lambda: ho.ForceTerm("arm", ONE, lambda x, p: p["a"]), "'arm' is not a measured actuator"),
    "unused": (lambda: ho.ForceTerm(CYLINDER, ONE, lambda x, p: x.speed), "does not depend on a; use all"),
    "foreign symbol": (lambda: ho.ForceTerm(CYLINDER, ONE, lambda x, p: p["a"] * ca.SX.sym("t")), "depends on t"),
    "vector": (lambda: ho.ForceTerm(CYLINDER, ONE, lambda x, p: ca.vertcat(p["a"], 1)), "returns 2 by 1 numbers"),
    "failing": (lambda: ho.ForceTerm(CYLINDER, ONE, lambda x, p: p["b"]), r"its function failed \('b'\)"),
    "taken": (lambda: ho.ForceTerm(CYLINDER, {"f_coulomb": ho.Coefficient("N")}, lambda x, p: p["f_coulomb"]),
              "lift_cylinder.f_coulomb is a parameter already"),
    "no coefficient": (lambda: ho.ForceTerm(CYLINDER, {}, lambda x, p: x.speed), "there are no coefficients"),
    "name": (lambda: ho.ForceTerm(CYLINDER, {"a.b": ho.Coefficient()}, lambda x, p: p["a.b"]), "is not a name"),
    "no term": (lambda: "drag", "this is str, not a ForceTerm"),
    "unit": (lambda: ho.Coefficient("bar"), "'bar' is not an SI unit"),
    "bounds": (lambda: ho.Coefficient(lower=1.0), "not within the bounds"),
    "sigma": (lambda: ho.Coefficient(sigma=0.0), "positive standard deviation"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_terms_are_refused_in_one_sentence(machine: ho.Machine, name: str) -> None:
    made, words = BAD[name]
    with pytest.raises(ho.HydrooptError, match=words) as refusal:
        ho.Model(machine, terms=[made()])
    assert "\n" not in str(refusal.value)
