"""The load that the C finds step by step is the one that a whole block of samples gives at once.

The block is solved in numpy's extended precision by the normal equations with the prior, so that what differs is the
C's own rounding. It is measured in standard deviations of the prior: those of phi as parts of them, those of the
covariance as parts of their products.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from fixtures import library
from fixtures.library import OK, OUT_OF_STROKE, Library, held, over
from fixtures.tiers import tiered
from hydroopt.model.model import Model

Array = np.ndarray
LOAD = np.array([1.0, 0.8, -0.3, 0.2, 0.12, 0.01, -0.006, 0.16, 0.008, 0.14])
"""What is carried, per kilogram."""
BUILD = ("-O0", "inverse_dynamics", "payload_update")
PRIOR = np.array([1.0, 1, 1, 1, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5])
MASS = {"cat215b": 500.0, "patu655_lift": 200.0, "kr300": 150.0, "panda_mukca": 3.0, "spatial": 50.0}
"""Mass of a load that the machine might carry, for which the prior of all ten numbers is about as large."""


class Samples(NamedTuple):
    """Motions with forces, what the model says of them, and the parameters of the machine."""

    values: dict[str, Array]
    predicted: Array
    rows: Array
    parameters: dict[str, Array]


@cache
def parameters(subject: str) -> tuple[Model, dict[str, Array]]:
    """The model of a machine whose numbers single precision can hold, and what `prepare` takes for it."""
    interface = library.subject(subject, "double").interface
    values = {name: held(array) for name, array in interface.values.items()}
    described = interface.machine
    if "geometry" in values:
        described = library.changed(interface.chain, values["geometry"])
    return Model(described), values


@cache
def samples(subject: str, count: int, seed: int = 0) -> Samples:
    """Random motions of a machine that carries a load on its last link, with noise in its forces."""
    rng = np.random.default_rng(seed)
    model, values = parameters(subject)
    q, qd, qdd = (held(each) for each in library.subjects.states(model.machine, rng, count))
    first = model.parameters.index(f"{model.machine.links[-1].name}.m")
    predicted = over(model.inverse_dynamics, q, qd, qdd, values["psi"])[0][:, :, 0]
    rows = over(model.regressor, q, qd, qdd)[0][:, :, first:first + 10]
    loaded = values["psi"].copy()
    loaded[first:first + 10] += MASS[subject] * LOAD
    force = over(model.inverse_dynamics, q, qd, qdd, loaded)[0][:, :, 0]
    std = held(0.02 * np.abs(force).max(axis=0) * rng.uniform(1, 2, force.shape))
    force = held(force + std * rng.standard_normal(std.shape))
    return Samples({"q": q, "qd": qd, "qdd": qdd, "force": force, "std": std}, predicted, rows, values)


def block(given: Samples, prior: Array, forgetting: float) -> tuple[Array, Array]:
    """phi (10,) and covariance (10, 10): weighted least squares; what is ``n`` steps back weighs forgetting^(n + 1).

    As much of the prior comes back in each step as was forgotten, so that it weighs the same at all times.
    """
    count = len(given.rows)
    weight = np.longdouble(forgetting) ** np.arange(count, 0, -1)
    rows = given.rows.astype(np.longdouble)
    over_variance = weight[:, None] / given.values["std"].astype(np.longdouble) ** 2
    left = given.values["force"].astype(np.longdouble) - given.predicted
    information = np.einsum("nij,ni,nik->jk", rows, over_variance, rows)
    information += np.diag(1 / prior.astype(np.longdouble) ** 2)
    shown = np.einsum("nij,ni->j", rows, over_variance * left)
    found = solved(information, np.column_stack([shown, np.eye(len(prior))]))
    return found[:, 0], found[:, 1:]


def solved(left: Array, right: Array) -> Array:
    """Gauss's elimination in the precision of its arguments; the matrix on the left is positive definite."""
    left, right = left.copy(), right.astype(left.dtype)
    scale = 1 / np.sqrt(np.diag(left))
    left, right = scale[:, None] * left * scale, scale[:, None] * right
    for k in range(len(left)):
        right[k] = right[k] / left[k, k]
        left[k] = left[k] / left[k, k]
        for i in range(len(left)):
            if i != k:
                right[i] = right[i] - left[i, k] * right[k]
                left[i] = left[i] - left[i, k] * left[k]
    return scale[:, None] * right


def recursion(lib: Library, given: Samples, prior: Array, forgetting: float) -> tuple[Array, Array]:
    load = lib.load(prior, forgetting)
    status = lib.update(lib.prepare(given.parameters), given.values, load, len(given.rows))
    assert set(status) <= {OK, OUT_OF_STROKE}
    unit, diagonal = load["unit"][0].astype(float), load["diagonal"][0].astype(float)
    covariance = unit @ np.diag(diagonal) @ unit.T
    assert np.array_equal(np.tril(unit), np.eye(len(unit)))
    assert np.all(diagonal > 0)
    assert np.array_equal(load["prior"][0], prior.astype(lib.real))
    np.testing.assert_allclose(load["std"][0], np.sqrt(np.diag(covariance)), rtol=10 * np.finfo(lib.real).eps)
    return load["phi"][0].astype(float), covariance


def test_elimination_solves() -> None:
    rng = np.random.default_rng(1)
    root = rng.standard_normal((10, 10)) * np.logspace(-3, 3, 10)
    right = rng.standard_normal((10, 3))
    matrix = (root.T @ root).astype(np.longdouble)
    scale = np.sqrt(np.diag(matrix))
    assert np.max(np.abs(matrix @ solved(matrix, right) - right) / scale[:, None]) < 1e-12


SUBJECTS = tuple(MASS)
CASES = {"double": ((1, 1.0), (10, 1.0), (100, 1.0), (1000, 1.0), (1, 0.96875), (100, 0.96875), (1000, 0.99609375)),
         "float": ((10, 1.0), (100, 1.0), (1000, 1.0), (100, 0.96875), (100, 0.99609375))}
"""Numbers of samples and weights of the past, which single precision can hold."""
TOLERANCE = {"double": 1e-12, "float": 1e-5}


@pytest.mark.parametrize(("subject", "real"), tiered(
    ((subject, real) for real in TOLERANCE for subject in SUBJECTS),
    lambda subject, real: (subject, real) in {("patu655_lift", "float"), ("cat215b", "double")}))
def test_recursion_gives_what_the_whole_block_gives(subject: str, real: str, libraries) -> None:
    lib, prior = libraries(subject, real, *BUILD), held(MASS[subject] * PRIOR)
    off = {}
    for count, forgetting in CASES[real]:
        given = samples(subject, count)
        phi, covariance = recursion(lib, given, prior, forgetting)
        said, spread = block(given, prior, forgetting)
        off[count, forgetting] = (float(np.max(np.abs(phi - said) / prior)),
                                  float(np.max(np.abs(covariance - spread) / np.outer(prior, prior))))
    assert all(max(each) <= TOLERANCE[real] for each in off.values()), off


@pytest.mark.slow
@pytest.mark.parametrize("real", TOLERANCE)
@pytest.mark.parametrize("subject", ["cat215b", "kr300"])
def test_load_is_found_within_its_covariance(subject: str, real: str, libraries) -> None:
    lib, prior, load = libraries(subject, real, *BUILD), MASS[subject] * PRIOR, MASS[subject] * LOAD
    of_mass, of_all = [], []
    for seed in range(40):
        phi, covariance = recursion(lib, samples(subject, 100, seed), prior, 1.0)
        assert np.sqrt(covariance[0, 0]) < 0.03 * load[0]  # it says something
        of_mass.append(abs(phi - load)[0] / np.sqrt(covariance[0, 0]))
        of_all.append((phi - load) @ np.linalg.solve(covariance, phi - load) / len(load))
    assert of_mass[0] < 3
    assert max(of_mass) < 4
    # the mean of forty chi-squared over their ten degrees of freedom has the standard deviation 0.07
    assert abs(np.mean(of_all) - 1) < 0.28


@pytest.mark.parametrize("real", TOLERANCE)
def test_standing_still_for_long_spoils_nothing(real: str, libraries) -> None:
    """With forgetting, what no motion shows would grow without end if no prior came back."""
    lib, subject = libraries("cat215b", real, *BUILD), "cat215b"
    prior, given = held(MASS[subject] * PRIOR), samples(subject, 200)
    load = lib.load(prior, forgetting=0.96875)
    constants = lib.prepare(given.parameters)
    still = {key: value[:1] * (key not in ("qd", "qdd")) for key, value in given.values.items()}
    still["force"] = still["force"] * 0 + 1000  # whatever it is
    waiting = {key: np.repeat(value, 20_000, axis=0) for key, value in still.items()}
    assert set(lib.update(constants, waiting, load, 20_000)) == {OK}
    assert np.all(load["std"][0] <= prior * 1.001)
    assert np.all(np.isfinite(load["phi"]))
    assert set(lib.update(constants, given.values, load, 200)) == {OK}
    assert abs(load["phi"][0, 0] - MASS[subject]) < 3 * load["std"][0, 0]
    assert load["std"][0, 0] < 0.1 * MASS[subject]


def test_a_load_that_is_picked_up_is_noticed_with_forgetting_only(libraries) -> None:
    lib, subject, count = libraries("cat215b", "double", *BUILD), "cat215b", 300
    given = samples(subject, count)
    carried = np.arange(count) >= 150
    force = given.values["force"] - ~carried[:, None] * (given.rows @ (MASS[subject] * LOAD))
    given = given._replace(values=given.values | {"force": force})
    found = {forgetting: recursion(lib, given, MASS[subject] * PRIOR, forgetting) for forgetting in (1.0, 0.96)}
    far = {forgetting: abs(phi[0] - MASS[subject]) / np.sqrt(covariance[0, 0])
           for forgetting, (phi, covariance) in found.items()}
    assert far[0.96] < 3
    assert far[1.0] > 10
