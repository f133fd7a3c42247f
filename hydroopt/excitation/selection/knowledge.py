"""What is known of geometry, bodies and friction before the next measurement: by the machine file and all answers.

Everything is linear about the machine file's numbers. `first` is the covariance C of the errors δ = (δθ, δψ) that file,
poses and answers leave. Motions are identified with the geometry known so far: the identification minimises
``‖R_ψ·δψ + R_θ·δθ − ε‖² + ‖δψ − δψ₀‖²_Λ`` over δψ, with Λ the inverse of C's part of ψ, so that

    δψ = H⁻¹·(Λ·δψ₀ − R_ψᵀ·R_θ·δθ + R_ψᵀ·ε),   H = Λ + R_ψᵀ·R_ψ:

errors of the geometry are passed on to bodies and friction, and forces tell nothing of the geometry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.stored_information import stored_information
from hydroopt.excitation.selection.measurements import Measurement
from hydroopt.machine.machine_file import read_machine
from hydroopt.model.model import Model
from hydroopt.results.answer import Answer, load
from hydroopt.results.json_file import Job
from hydroopt.results.status import Status
from hydroopt.results.tables import COVARIANCE, read_covariance
from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What is known of P numbers: f of the geometry and of what poses share, then ψ.

    Attributes:
        names: of the numbers.
        geometry: f.
        first: (P, P) covariance C of their errors before motions are identified.
        by_motion: (P, P) the information RᵀR of motions, which are identified with the geometry known so far.
        taken: which parts of each measurement (by name) it rests on, beside the machine file and answers.
    """

    names: tuple[str, ...]
    geometry: int
    first: Array
    by_motion: Array
    taken: Mapping[str, tuple[int, ...]] = field(default_factory=dict)

    @classmethod
    def stating(cls, names: Sequence[str], of_geometry: Array, of_psi: Array) -> Knowledge:
        """By information on the geometry (f, f) and on ψ (p, p) alone."""
        first = inverse(block_diag(of_geometry, of_psi))
        return cls(tuple(names), len(of_geometry), first, np.zeros_like(first))

    def after(self, measurement: Measurement, part: int) -> Knowledge:
        """After one part of a measurement."""
        found = self.with_rows(measurement.rows[part], measurement.own, geometry_exact=measurement.geometry_exact)
        parts = (*self.taken.get(measurement.name, ()), part)
        return replace(found, taken={**self.taken, measurement.name: parts})

    def with_rows(self, rows: Array, own: NDArray[np.intp], *, geometry_exact: bool) -> Knowledge:
        """After rows (m, w) on `own` of the numbers, of a motion if the geometry counts as exact in it."""
        if geometry_exact:
            added = self.by_motion.copy()
            added[np.ix_(own, own)] += rows.T @ rows
            return replace(self, by_motion=added)
        spread = rows @ self.first[own]
        core = np.eye(len(rows)) + spread[:, own] @ rows.T
        first = self.first - spread.T @ np.linalg.solve(core, spread)
        return replace(self, first=(first + first.T) / 2)

    @cached_property
    def _identified(self) -> tuple[Array, Array]:
        """Λ (p, p) and H⁻¹ (p, p)."""
        before = inverse(self.first[self.dynamic, self.dynamic])
        return before, inverse(before + self.by_motion[self.dynamic, self.dynamic])

    @cached_property
    def passed_on(self) -> Array:
        """(P, P) by how much errors after identification follow those before it."""
        before, after = self._identified
        made = np.eye(len(self.names))
        made[self.dynamic, self.own] = -after @ self.by_motion[self.dynamic, self.own]
        made[self.dynamic, self.dynamic] = after @ before
        return made

    @cached_property
    def covariance(self) -> Array:
        """(P, P) of the errors of all numbers."""
        if not self.by_motion.any():
            return self.first
        _, after = self._identified
        made = self.passed_on @ self.first @ self.passed_on.T
        made[self.dynamic, self.dynamic] += after @ self.by_motion[self.dynamic, self.dynamic] @ after
        return np.asarray((made + made.T) / 2)

    @property
    def own(self) -> slice:
        """Where the geometry is."""
        return slice(0, self.geometry)

    @property
    def dynamic(self) -> slice:
        """Where ψ is."""
        return slice(self.geometry, len(self.names))

    def with_answers(self, model: Model, folders: Sequence[str | Path]) -> Knowledge:
        """Also what the answers in some folders tell.

        Args:
            model: of the machine that the answers are of.
            folders: that `identify` or `calibrate` wrote; of a calibration also the one that wrote this machine, whose
                file states confidences without their correlations.

        Raises:
            ProblemError: a folder holds none of these answers, or it is of another machine.
        """
        stated = inverse(self.first)
        information, answers = stated.copy(), [(folder, load(folder)) for folder in map(Path, folders)]
        for folder, answer in answers:
            if _wrote(answer, model):  # its confidences stand in the file, with correlations here
                places, within = self._shared(answer, folder)
                information[np.ix_(places, places)] = within
        for folder, answer in answers:
            if not _wrote(answer, model):
                places, added = self._added(model, answer, folder, stated)
                information[np.ix_(places, places)] += added
        return replace(self, first=inverse(information))

    def _shared(self, answer: Answer, folder: Path) -> tuple[list[int], Array]:
        """Places (k,) of the numbers that an answer and this share, and the information (k, k) on them by its file."""
        if (text := answer.text_of(COVARIANCE)) is None:
            raise ProblemError(f"there is no {COVARIANCE} beside the answer", where=str(folder),
                               remedy="calibrate again with this version, by method joint")
        found, covariance = read_covariance(text, str(folder / COVARIANCE))
        taken = [k for k, name in enumerate(found) if name in self.names]
        return [self.names.index(found[k]) for k in taken], inverse(covariance[np.ix_(taken, taken)])

    def _added(self, model: Model, answer: Answer, folder: Path, stated: Array) -> tuple[list[int], Array]:
        """Places (k,) of numbers, and the information (k, k) that an answer adds to the `stated` one (P, P) on them."""
        if answer.job not in (Job.IDENTIFICATION, Job.CALIBRATION):
            raise ProblemError(f"this is a {answer.job}, which states no covariance of the machine's numbers",
                               where=str(folder), remedy="name folders that identify or calibrate wrote")
        if answer.status is not Status.OK:
            raise ProblemError(f"the answer is {answer.status}, so that nothing can be planned from it",
                               where=str(folder), remedy="do first what its report says, or leave it out")
        if answer.machine_id.sha256 != model.machine.sha256:
            raise ProblemError("the answer is of another machine description", where=str(folder),
                               remedy="give the machine that it was computed with: its file, or the folder of the "
                               "calibration that wrote it")
        if answer.job is Job.IDENTIFICATION and answer.text_of(COVARIANCE) is None:
            triangles = stored_information(model, folder).triangles
            rows = triangles.reshape(-1, triangles.shape[2])[:, :-1]
            return list(range(self.geometry, len(self.names))), rows.T @ rows
        places, within = self._shared(answer, folder)
        before = stated[np.ix_(places, places)]
        root = np.sqrt(np.diag(before))
        beyond = within if answer.details().get("priors") is False else within - before
        values, axes = np.linalg.eigh(beyond / np.outer(root, root))
        return places, axes * np.maximum(values, 0.0) @ axes.T * np.outer(root, root)


def _wrote(answer: Answer, model: Model) -> bool:
    """Whether it is the calibration that wrote the machine's own file."""
    text = answer.text_of(f"{answer.machine_id.name}.toml")
    return (answer.job is Job.CALIBRATION and answer.machine_id.sha256 != model.machine.sha256 and text is not None
            and answer.text_of(COVARIANCE) is not None and read_machine(text).sha256 == model.machine.sha256)


def inverse(matrix: Array) -> Array:
    """Of a positive definite matrix whose numbers have any units."""
    size = np.sqrt(np.diag(matrix))
    return np.asarray(np.linalg.inv(matrix / np.outer(size, size)) / np.outer(size, size))
