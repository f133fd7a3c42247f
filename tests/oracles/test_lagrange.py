"""Newton-Euler against Lagrange's equations, which differentiate energies and know positions alone."""

import numpy as np
import pytest

from fixtures.tiers import tiered
from oracles.subjects import SUBJECTS, forces, model, random_bodies, relative_error, states


@pytest.mark.parametrize(("name", "complete"), tiered(
    ((name, complete) for name in SUBJECTS for complete in (True, False)),
    lambda name, complete: name not in ("made_up", "kr300")
    and not (complete and name == "cat215b")))  # these are differentiated for long
def test_bodies(name, complete):
    subject = model(name, actuator_inertia=complete)
    rng = np.random.default_rng(24)
    psi, _ = random_bodies(subject, rng)
    state = states(subject.machine, rng, 100)
    K, = subject.over(subject.regressor, *state)
    expected, = subject.over(subject.lagrange_forces, *state, np.tile(psi, (100, 1)))
    assert relative_error(K @ psi, expected[:, :, 0]) < 1e-9
    assert relative_error(forces(subject, state, psi), K @ psi) < 1e-12
