"""The ten inertial parameters against point masses, and which of the excavator's bodies can exist."""

import numpy as np
import pytest

from hydroopt.machine.machine_file import load_machine
from hydroopt.spatial import inertia


def cloud(rng, count=8):
    return rng.uniform(1, 5, count), rng.uniform(-1, 1, (count, 3)) + rng.uniform(-2, 2, 3)


def moments(masses, points):
    """Inertia tensor of point masses about the origin, entry by entry."""
    return sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True))


@pytest.mark.parametrize("seed", range(10))
def test_parallel_axes(seed):
    masses, points = cloud(np.random.default_rng(seed))
    m, com = masses.sum(), masses @ points / masses.sum()
    about_com = moments(masses, points - com)[np.triu_indices(3)]
    phi = inertia.from_centre_of_mass(m, com, about_com)
    direct = [m, *masses @ points, *moments(masses, points)[np.triu_indices(3)]]
    np.testing.assert_allclose(phi, direct, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(inertia.tensor(phi[4:]), moments(masses, points), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(inertia.centre_of_mass(phi), com, rtol=1e-13)


@pytest.mark.parametrize("seed", range(10))
def test_pseudo_inertia_is_the_second_moment_of_mass(seed):
    masses, points = cloud(np.random.default_rng(seed))
    lifted = np.column_stack([points, np.ones(len(points))])
    expected = lifted.T @ (masses[:, None] * lifted)
    phi = np.array([masses.sum(), *masses @ points, *moments(masses, points)[np.triu_indices(3)]])
    found = inertia.pseudo_inertia(phi)
    by_basis = np.einsum("k,kij", phi, inertia.PSEUDO_BASIS)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(by_basis, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(inertia.from_pseudo_inertia(found), phi, rtol=1e-12, atol=1e-12)
    assert inertia.smallest_eigenvalue(phi) == pytest.approx(np.linalg.eigvalsh(expected)[0], rel=1e-9)


def test_massless_body_has_no_centre():
    assert inertia.centre_of_mass(np.zeros(10)) is None


@pytest.mark.parametrize(("link", "eigenvalue"), [("swing", -3209), ("boom", -117), ("stick", -36)])
def test_bodies_of_table_13(link, eigenvalue):
    literal, consistent = (load_machine("cat215b", parameter_set=name).link(link).body.phi
                           for name in ("thesis_literal", "consistent"))
    assert inertia.smallest_eigenvalue(literal) == pytest.approx(eigenvalue, abs=0.5)
    assert inertia.smallest_eigenvalue(consistent) > 0
    np.testing.assert_allclose(literal[:4], consistent[:4], rtol=1e-3, atol=1)  # both are rounded
