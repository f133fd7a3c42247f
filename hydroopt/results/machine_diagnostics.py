"""What a reader should know of a machine file before trusting anything that rests on it."""

from __future__ import annotations

import numpy as np

from hydroopt.machine.machine import Machine
from hydroopt.parameters.dynamic import bodies
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.wording import Kind
from hydroopt.spatial import inertia

ROUNDED = 1e-6
"""Smallest eigenvalue of a pseudo-inertia, as a part of its trace, that rounded numbers of a point mass may give."""


def machine_diagnostics(machine: Machine) -> tuple[Diagnostic, ...]:
    """Diagnostics of a machine's nominal numbers; none if they can be true.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> machine_diagnostics(load_machine("cat215b"))
    ()
    """
    pseudo = {owner: inertia.pseudo_inertia(owned.body.phi)
              for owner, owned in bodies(machine, calibrator=True).items()}
    impossible = tuple(owner for owner, matrix in pseudo.items()
                       if np.linalg.eigvalsh(matrix)[0] < -ROUNDED * max(float(np.trace(matrix)), 1e-9))
    return (Diagnostic(Kind.IMPOSSIBLE_NOMINAL_BODIES, impossible),) if impossible else ()
