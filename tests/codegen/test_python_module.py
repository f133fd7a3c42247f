"""The generated Python module computes what the kernels of the model in Python compute."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from fixtures import library
from fixtures.library import NOT_FINITE, STALE, held, write
from fixtures.tiers import tiered
from fixtures.tools import must
from oracles import subjects

TOLERANCE = {"double": 1e-12, "float": 1e-4}
ROUTINES = ("forward_kinematics", "inverse_dynamics", "regressor", "mass_matrix")
Modules = Callable[[str, str], ModuleType]


@pytest.fixture(scope="module")
def modules(tmp_path_factory: pytest.TempPathFactory) -> Modules:
    """The module of a machine, imported from its folder."""
    home = tmp_path_factory.mktemp("modules")

    @cache
    def get(subject: str, real: str) -> ModuleType:
        made = library.code(library.machine(subject), single=real == "float", hosts=("python",), routines=ROUTINES)
        place = write(library.files(made), home / f"{subject}_{real}")
        must(["make", f"lib{made.name}.so", "CFLAGS=-O1 -Werror"], place)
        spec = importlib.util.spec_from_file_location(f"{subject}_{real}", place / f"{made.name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return get


@pytest.mark.parametrize(("subject", "real"), tiered(
    [("patu655_lift", "double"), ("patu655_lift", "float"), ("cat215b", "double"), ("cat215b", "float"),
     ("kr300", "double")], lambda subject, real: subject == "patu655_lift" or (subject, real) == ("cat215b", "double")))
def test_it_computes_what_the_kernels_compute(subject: str, real: str, modules: Modules) -> None:
    described = library.machine(subject)
    model, count = library.code(described).interface.complete, 200
    q, qd, qdd = (held(each) for each in subjects.states(described, np.random.default_rng(5), count))
    if described.cylinders:  # within their strokes
        lengths = model.over(model.cylinder_kinematics, q, qd, qdd)[0][:, :len(described.cylinders), 0]
        shortest = np.array([c.dead_length for c in described.cylinders])
        stroke = np.array([c.stroke for c in described.cylinders])
        inside = np.all((lengths > shortest + 1e-5) & (lengths < shortest + stroke - 1e-5), axis=1)
        q, qd, qdd = q[inside], qd[inside], qdd[inside]
    assert len(q) > 20
    kernels = {"inverse_dynamics": model.over(model.inverse_dynamics, q, qd, qdd, model.parameters.nominal)[0][..., 0],
               "regressor": model.over(model.regressor, q, qd, qdd)[0],
               "mass_matrix": model.over(model.mass_matrix, q, model.parameters.nominal)[0]}
    member = {"inverse_dynamics": "force", "regressor": "K", "mass_matrix": "mass_matrix"}
    generated = modules(subject, real).Model()
    for name, expected in kernels.items():
        given = ((each[k] for each in (q, qd, qdd)[:1 if name == "mass_matrix" else 3]) for k in range(len(q)))
        found = np.array([getattr(generated, name)(*state)[member[name]] for state in given], float)
        assert found.shape == expected.shape
        scale = np.abs(expected).max()
        assert np.abs(found - expected).max() < TOLERANCE[real] * scale, name


def test_what_has_no_result_is_refused_with_its_status(modules: Modules) -> None:
    module = modules("patu655_lift", "double")
    model = module.Model()
    with pytest.raises(module.Refused, match="inverse_dynamics: NOT_FINITE") as refused:
        model.inverse_dynamics([np.nan], [0.0], [0.0])
    assert refused.value.status == NOT_FINITE
    for wrong in (0.3, [0.3, 0.4]):
        with pytest.raises(ValueError, match="q has the shape"):
            model.inverse_dynamics(wrong, [0.0], [0.0])
    values = model.nominal()
    values["interface"] += 1
    with pytest.raises(module.Refused) as stale:
        module.Model(values)
    assert stale.value.status == STALE


def test_parameters_can_be_changed(modules: Modules) -> None:
    module = modules("patu655_lift", "double")
    model, place = module.Model(), module.NAMES["psi"].index("lift_cylinder.f_coulomb")
    values = model.nominal()
    values["psi"][place] += 1000.0
    state = [0.25], [0.5], [-0.125]
    force = model.inverse_dynamics(*state)["force"][0]
    assert abs(module.Model(values).inverse_dynamics(*state)["force"][0] - force) == pytest.approx(1000.0, abs=1e-6)
    assert "interface" in model.version


def test_a_missing_library_says_how_to_build_it(modules: Modules, monkeypatch: pytest.MonkeyPatch,
                                                tmp_path: Path) -> None:
    module = modules("patu655_lift", "double")
    monkeypatch.setattr(module, "__file__", str(tmp_path / "patu655_lift.py"))
    with pytest.raises(FileNotFoundError, match=r"make libpatu655_lift\.so"):
        module.Model()
