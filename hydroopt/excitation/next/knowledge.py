"""What is known of geometry, bodies and friction before the next measurement: by the machine file and all answers.

Everything is linear about the machine file's numbers. `first` is the covariance C of the errors δ = (δθ, δψ) that file,
poses and answers leave. Motions are identified with the geometry known so far: the identification minimises
``‖R_ψ·δψ + R_θ·δθ − ε‖² + ‖δψ − δψ₀‖²_Λ`` over δψ, with Λ the inverse of C's part of ψ, so that

    δψ = H⁻¹·(Λ·δψ₀ − R_ψᵀ·R_θ·δθ + R_ψᵀ·ε),   H = Λ + R_ψᵀ·R_ψ:

errors of the geometry are passed on to bodies and friction, and forces tell nothing of the geometry.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.stored_information import stored_information
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
        stated: (P, P) information that the machine file states.
        by_motion: (P, P) the information RᵀR of motions, which are identified with the geometry known so far.
    """

    names: tuple[str, ...]
    geometry: int
    first: Array
    stated: Array
    by_motion: Array
    _before: Array | None = None

    @classmethod
    def stating(cls, names: Sequence[str], of_geometry: Array, of_psi: Array) -> Knowledge:
        """By information on the geometry (f, f) and on ψ (p, p) alone."""
        f, count = len(of_geometry), len(names)
        information, first = np.zeros((count, count)), np.zeros((count, count))
        information[:f, :f], information[f:, f:] = of_geometry, of_psi
        first[:f, :f], first[f:, f:] = inverse(of_geometry), inverse(of_psi)
        return cls(tuple(names), f, first, information, np.zeros((count, count)))

    def with_rows(self, rows: Array, own: slice, *, geometry_exact: bool) -> Knowledge:
        """After rows (m, w) on `own` of the numbers, of a motion if the geometry counts as exact in it."""
        if geometry_exact:
            added = self.by_motion.copy()
            added[own, own] += rows.T @ rows
            return replace(self, by_motion=added, _before=self.before)
        spread = rows @ self.first[own]
        core = np.eye(len(rows)) + spread[:, own] @ rows.T
        first = self.first - spread.T @ np.linalg.solve(core, spread)
        apart = own.stop <= self.geometry and not self.first[self.own, self.dynamic].any()
        return replace(self, first=(first + first.T) / 2, _before=self.before if apart else None)

    @cached_property
    def before(self) -> Array:
        """Λ (p, p)."""
        return inverse(self.first[self.dynamic, self.dynamic]) if self._before is None else self._before

    @cached_property
    def _identified(self) -> tuple[Array, Array]:
        """Λ (p, p) and H⁻¹ (p, p)."""
        return self.before, inverse(self.before + self.by_motion[self.dynamic, self.dynamic])

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
        information, others = inverse(self.first), list[Path]()
        for folder in map(Path, folders):
            if (known := self._of_the_file(model, folder)) is None:
                others.append(folder)
            else:
                places, whole = known
                information[np.ix_(places, places)] = whole
        for folder in others:
            places, added = self._added(model, folder)
            information[np.ix_(places, places)] += added
        return replace(self, first=inverse(information), _before=None)

    def _of_the_file(self, model: Model, folder: Path) -> tuple[list[int], Array] | None:
        """Places (k,) of the numbers of a calibration that wrote the machine's own file, and the information (k, k)
        that their confidences in it stand for; None of any other answer."""
        answer = load(folder)
        text = answer.text_of(f"{answer.machine_id.name}.toml")
        if (answer.job is not Job.CALIBRATION or answer.machine_id.sha256 == model.machine.sha256 or text is None
                or answer.text_of(COVARIANCE) is None or read_machine(text).sha256 != model.machine.sha256):
            return None
        return self._shared(answer, folder)

    def _shared(self, answer: Answer, folder: Path) -> tuple[list[int], Array]:
        """Places (k,) of the numbers that an answer and this share, and the information (k, k) on them by its file."""
        found, covariance = read_covariance(answer.text_of(COVARIANCE) or "", str(folder / COVARIANCE))
        shared = [(k, self.names.index(name)) for k, name in enumerate(found) if name in self.names]
        taken, places = [k for k, _ in shared], [place for _, place in shared]
        return places, inverse(covariance[np.ix_(taken, taken)])

    def _added(self, model: Model, folder: Path) -> tuple[list[int], Array]:
        """Places (k,) of numbers, and the information (k, k) that an answer adds on them."""
        answer = load(folder)
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
        return self._beyond_file(answer, folder)

    def _beyond_file(self, answer: Answer, folder: Path) -> tuple[list[int], Array]:
        if answer.text_of(COVARIANCE) is None:
            raise ProblemError(f"there is no {COVARIANCE} beside the answer", where=str(folder),
                               remedy="calibrate again with this version, by method joint")
        places, within = self._shared(answer, folder)
        root = np.sqrt(np.diag(self.stated)[places])
        root = np.where(root > 0, root, 1.0)
        before = 0.0 if answer.details().get("priors") is False else self.stated[np.ix_(places, places)]
        values, axes = np.linalg.eigh((within - before) / np.outer(root, root))
        return places, axes * np.maximum(values, 0.0) @ axes.T * np.outer(root, root)


def inverse(matrix: Array) -> Array:
    """Of a positive definite matrix whose numbers have any units."""
    size = np.sqrt(np.diag(matrix))
    return np.asarray(np.linalg.inv(matrix / np.outer(size, size)) / np.outer(size, size))
