"""Kinds of parameters: what they are by, whom they belong to, and that each word means the same in every job."""

from __future__ import annotations

import re

import numpy as np
import pytest

from fixtures.tiers import machines
from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.session_comparison import named_parts
from hydroopt.excitation.criteria import design_parameters, presumed_noise
from hydroopt.machine.machine_file import load_machine
from hydroopt.machine.parameter_kind import INERTIAL_KINDS, ParameterKind
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.model import Model
from hydroopt.parameters import hydraulic
from hydroopt.parameters.parameter_set import GROUPS
from hydroopt.spatial.inertia import NAMES

KINDS = {
    r"m": "MASS", r"mc_[xyz]": "FIRST_MOMENT", r"I_[xyz]{2}": "MOMENT_OF_INERTIA", r"rotor_inertia": "ROTOR_INERTIA",
    r"(f|tau)_coulomb(_reverse)?": "COULOMB_FRICTION", r"(f|tau)_viscous(_reverse)?": "VISCOUS_FRICTION",
    r"(f|tau)_stribeck": "STRIBECK_FRICTION", r"v_stribeck": "STRIBECK_SPEED", r"f_seal": "SEAL_FRICTION",
    r"n_(barrel|rod)": "PIN_FRICTION", r"(f|tau)_offset": "FORCE_OFFSET", r"precharge": "GAS_PRESSURE",
    r"(theta|alpha|beta)": "ANGLE", r"[ad]": "LENGTH", r"[xyz]": "POSITION", r"(roll|pitch|yaw)": "ORIENTATION",
    r"dead_length": "DEAD_LENGTH", r"compliance": "COMPLIANCE", r"bulk_modulus": "BULK_MODULUS",
    r"hose_modulus": "HOSE_MODULUS", r"air(_[ab])?": "AIR", r"(rated_flow|flow_(pa|at|pb|bt))": "RATED_FLOW",
    r"dead_band(_reverse)?": "DEAD_BAND", r"overlap": "OVERLAP", r"natural_frequency": "SPOOL_FREQUENCY",
    r"damping": "SPOOL_DAMPING", r"delay": "DELAY", r"volume_[ab]": "VOLUME", r"leakage(_[ab])?": "LEAKAGE"}
"""By what stands after the last dot of a name."""


@pytest.mark.parametrize("name", machines())
def test_every_parameter_of_every_bundled_machine_has_its_kind_and_owner(name: str) -> None:
    machine = load_machine(name)
    model = Model(machine)
    parts = {part.name for part in (*machine.links, *machine.pinned, *machine.actuators)} | {"oil"}
    for parameters in (model.parameters, hydraulic.parameter_set(machine), KinematicModel(machine).parameters):
        assert len(parameters.kinds) == len(parameters)
        for one, kind in zip(parameters.names, parameters.kinds, strict=True):
            owner, _, element = one.rpartition(".")
            assert [ParameterKind[k] for pattern, k in KINDS.items() if re.fullmatch(pattern, element)] == [kind]
            assert parameters.owner(one) == owner
            if parameters is model.parameters:
                assert owner.partition(".")[0] in parts
    for owner, columns in model.parameters.bodies.items():
        assert model.parameters.names[columns] == tuple(f"{owner}.{element}" for element in NAMES)
        assert model.parameters.kinds[columns] == INERTIAL_KINDS
    inertial = sum(kind.is_inertial for kind in model.parameters.kinds)
    assert inertial == 10 * len(model.parameters.bodies)


def test_locked_angles_and_drifts_belong_to_their_joint(monkeypatch: pytest.MonkeyPatch) -> None:
    parameters = Model(load_machine("panda")).parameters
    names = ("boom.locked.first.x", "boom.drift.first", *parameters.names[2:])
    kinds = (ParameterKind.LOCKED_ANGLE, ParameterKind.DRIFT, *parameters.kinds[2:])
    monkeypatch.setitem(parameters.__dict__, "names", names)
    monkeypatch.setitem(parameters.__dict__, "kinds", kinds)
    assert [parameters.owner(name) for name in names[:2]] == ["boom", "boom"]
    with pytest.raises(ProblemError):
        parameters.owner("nobody.m")


def test_friction_is_the_same_to_comparison_and_excitation() -> None:
    model = Model(load_machine("kr300"))  # with rotor inertias and a gas cylinder, which are no friction
    parameters = model.parameters
    expected = [k for k, name in enumerate(parameters.names) if re.search(r"coulomb|viscous|stribeck|seal|\.n_", name)]
    assert {"rotor inertia", "gas pressure"} <= {str(kind) for kind in parameters.kinds}
    assert parameters.matching("friction") == expected
    assert named_parts(parameters, ["friction"]) == tuple(parameters.names[k] for k in expected)
    asked = design_parameters(model, presumed_noise(model), focus=["friction"])
    touched = np.flatnonzero(np.any(asked.structure.grouping[:, expected] != 0, axis=1))
    assert sorted(asked.focus) == touched.tolist()
    others = [k for k, kind in enumerate(parameters.kinds) if kind in (ParameterKind.ROTOR_INERTIA,
                                                                       ParameterKind.GAS_PRESSURE)]
    alone = np.flatnonzero(np.any(asked.structure.grouping[:, others] != 0, axis=1))
    assert not set(alone) <= set(asked.focus)


def test_words_name_groups_parts_and_parameters() -> None:
    parameters = Model(load_machine("cat215b")).parameters
    assert set(GROUPS) == {"friction", "offset"}
    assert {str(parameters.kinds[k]) for k in parameters.matching("offset")} == {"force offset"}
    assert [parameters.names[k] for k in parameters.matching("boom_cylinder.rod")] == [
        f"boom_cylinder.rod.{element}" for element in NAMES]
    assert parameters.matching("boom.m") == [parameters.index("boom.m")]
    assert not parameters.matching("boo")


def test_no_kind_is_both_inertial_and_friction() -> None:
    assert not [kind for kind in ParameterKind if kind.is_inertial and kind.is_friction]
    assert [kind for kind in ParameterKind if kind.is_inertial] == list(dict.fromkeys(INERTIAL_KINDS))
