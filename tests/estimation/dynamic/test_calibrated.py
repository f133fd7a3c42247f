"""The calibrated machine is the estimate in the form of a machine file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.calibrated import calibrated_machine
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.regressor_qr import predict
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.model.model import Model
from hydroopt.parameters.dynamic import parameter_set


@pytest.fixture(scope="module")
def calibrated(noisy_estimate: Estimate) -> Machine:
    return calibrated_machine(noisy_estimate)


def test_survives_being_written_and_read(calibrated: Machine) -> None:
    assert read_machine(dump_machine(calibrated)) == calibrated


def test_nominal_parameters_are_the_estimate(calibrated: Machine, noisy_estimate: Estimate) -> None:
    parameters = parameter_set(read_machine(dump_machine(calibrated)))
    assert parameters.names == noisy_estimate.problem.parameters.names
    np.testing.assert_allclose(parameters.nominal, noisy_estimate.psi, rtol=1e-12, atol=0)


def test_predicts_the_same_forces(calibrated: Machine, noisy_estimate: Estimate) -> None:
    data, model = noisy_estimate.problem.validation[0], Model(calibrated)
    forces = predict(model, data, model.parameters.nominal)
    np.testing.assert_allclose(forces, noisy_estimate.predictions["validation"][0], rtol=1e-9, atol=1e-6)


def test_confidences_are_those_found_and_keep_their_source(calibrated: Machine, noisy_estimate: Estimate) -> None:
    std = dict(zip(noisy_estimate.problem.parameters.names, noisy_estimate.std, strict=True))
    note = calibrated.notes["boom.body.m"]
    assert (note.sigma, note.relative) == (pytest.approx(std["boom.m"]), False)
    assert note.source.startswith("identified by sdp from motion 1, motion 2")
    assert calibrated.notes["boom.body.mc"].sigma == pytest.approx(max(std[f"boom.mc_{axis}"] for axis in "xyz"))
    assert calibrated.notes["stick_cylinder.friction.coulomb"].sigma == pytest.approx(std["stick_cylinder.f_coulomb"])
    assert "boom.body.com" not in calibrated.notes
    assert calibrated.notes["boom.joint.a"] == noisy_estimate.problem.model.machine.notes["boom.joint.a"]


@pytest.mark.parametrize("name", ["stick_cylinder.f_coulomb", "boom_cylinder.f_coulomb"])
def test_a_friction_beyond_its_bound_by_a_solver_s_rounding_stands_at_the_bound(noisy_estimate: Estimate,
                                                                               name: str) -> None:
    parameters = noisy_estimate.problem.parameters
    k = parameters.index(name)

    def beyond(part: float) -> Estimate:
        psi = noisy_estimate.psi.copy()
        psi[k] = -part * parameters.scale[k]
        return replace(noisy_estimate, psi=psi)

    assert parameter_set(calibrated_machine(beyond(1e-7))).nominal[k] == 0.0
    with pytest.raises(ProblemError, match=f"{name} cannot exist"):
        calibrated_machine(beyond(1e-4))


def test_geometry_sensors_and_limits_stay(calibrated: Machine, noisy_estimate: Estimate) -> None:
    nominal = noisy_estimate.problem.model.machine
    assert calibrated.sensors == nominal.sensors
    for one, other in zip(calibrated.links, nominal.links, strict=True):
        assert one.joint.model_copy(update={"friction": None}) == other.joint.model_copy(update={"friction": None})
    for one, other in zip(calibrated.cylinders, nominal.cylinders, strict=True):
        assert (one.barrel.pin, one.rod.pin, one.areas) == (other.barrel.pin, other.rod.pin, other.areas)


def test_experiments_of_a_model_with_other_parameters_are_refused(noisy: IdentificationProblem) -> None:
    small = Model(noisy.model.machine, actuator_inertia=False)
    for some in ((noisy.experiments, ()), ((), noisy.validation)):
        with pytest.raises(ProblemError, match="a model that has other parameters than the problem's"):
            IdentificationProblem(small, *some, force_std=noisy.force_std)


def test_reduced_model_predicts_the_same_after_reloading(noisy: IdentificationProblem) -> None:
    """The links took over what barrels and rods demand, so that these must not be counted again."""
    small = Model(noisy.model.machine, actuator_inertia=False)
    train, held_out = ([replace(data, model=small) for data in some] for some in (noisy.experiments, noisy.validation))
    reduced = IdentificationProblem(small, tuple(train), tuple(held_out), noisy.force_std)
    estimate = identify(reduced, "sdp", intervals=False)
    model = Model(read_machine(dump_machine(calibrated_machine(estimate))))
    forces = predict(model, estimate.problem.validation[0], model.parameters.nominal)
    np.testing.assert_allclose(forces, estimate.predictions["validation"][0], rtol=1e-9, atol=1e-6)


def test_what_the_data_did_not_show_keeps_its_confidence_and_says_so(calibrated: Machine,
                                                                     noisy: IdentificationProblem) -> None:
    nominal = dict(zip(noisy.parameters.names, noisy.parameters.scale, strict=True))
    note = calibrated.notes["swing.body.m"]
    assert note.sigma == pytest.approx(nominal["swing.m"])
    assert "not identified" in note.source
    assert "not identified: swing.I_xx" in calibrated.notes["swing.body.inertia"].source
    held = calibrated_machine(identify(noisy.fix("boom.m", 1500.0), "sdp", intervals=False))
    assert held.notes["boom.body.m"].source == "held at a value chosen by the user"


def test_impossible_bodies_are_refused_by_name(noisy: IdentificationProblem) -> None:
    estimate = identify(noisy, "wls")
    impossible = [owner for owner, smallest in estimate.consistency.items() if smallest < 0]
    assert impossible
    with pytest.raises(ProblemError, match=f"{impossible[0]}.* cannot exist; identify with method 'sdp'"):
        calibrated_machine(estimate)
