"""The information of one session's logs about the parameters, saved for later comparisons."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.estimation.dynamic.score_covariance import STEADY
from hydroopt.estimation.dynamic.training_logs import contradictions, losses
from hydroopt.estimation.dynamic.weighted_residuals import weighted_residuals
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.inference.whitening import gaussian_posterior
from hydroopt.logs.frames import all_of
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.results.answer import load
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.json_file import Job, not_an_answer
from hydroopt.results.status import Status
from hydroopt.spatial.inertia import Array
from hydroopt.support.progress import Progress

INFORMATION = "information.csv"
"""File beside estimate.json that holds the triangles of an identification, so that its logs need not be read again."""
PREPARED = 0.4
"""Part of the work on two sessions that preparing them is; most of the rest is sampling."""


@dataclass(frozen=True, eq=False)
class StoredInformation:
    """The information ``Σ_i ‖T_i·[ψ; −1]‖²`` of a session's residuals about ψ.

    Attributes:
        triangles: (·, p+1, p+1) T_i, one per actuator, whose rows are independent and of variance 1; or one of all
            actuators, see `WeightedResiduals`.
        freedom: (·, p+1) degrees of freedom with which the variance of each row was estimated; inf if it was not.
        split_half: φ, how much more friction and offsets differ between the halves of the logs than residuals explain;
            1 where nothing changes.
        steady: whether the halves of no log differ (`STEADY`).
        sigma: (n,) σ [N or N·m].
        correlation_time: (n,) τ in samples.
        samples: (n,) number of residuals of each actuator.
        inputs: path, digest and range of samples of each log.
        of_logs: what contradicts the machine file in the logs as they are read.
    """

    triangles: Array
    freedom: Array
    split_half: float
    steady: bool
    sigma: Array
    correlation_time: Array
    samples: Array
    inputs: tuple[Mapping[str, Any], ...]
    of_logs: tuple[Diagnostic, ...] = ()

    def weights(self, machine: Machine) -> dict[str, dict[str, float]]:
        """σ, τ and number of residuals of each balance, by name."""
        return {balance.name: {"sigma": float(sigma), "correlation_time": float(time), "samples": int(samples)}
                for balance, sigma, time, samples in zip(machine.balances, self.sigma, self.correlation_time,
                                                          self.samples, strict=True)}


def stored_information(model: Model, source: Log | Sequence[Log] | str | Path,
                       smoothing: Smoothing | None = None) -> StoredInformation:
    """The information of logs, or that of the folder which `hydroopt identify` wrote from them.

    Args:
        model: the machine's.
        given: logs, or the folder.
        smoothing: of the logs.

    Raises:
        LogError, IdentifiabilityError: the logs cannot be used.
        ProblemError: there is no log, the folder cannot be used, or forces are not linear in the parameters.
    """
    if not model.linear:
        raise ProblemError("forces are not linear in a Stribeck speed, but comparing sessions needs linear forces",
                           where=model.machine.name, remedy="leave 'stribeck' and 'stribeck_speed' out of the machine "
                           "file that sessions are compared with")
    if isinstance(source, str | Path):
        return _read(model, Path(source))
    source = all_of(source, (Log,), "log", model.machine.name)
    problem = identification_problem(model.machine, source, smoothing=smoothing)
    weighted = weighted_residuals(problem, RANK_TOLERANCE, lambda R, r: gaussian_posterior(problem, R, r).offset,
                                  model.parameters.nominal)
    inputs = [{"path": log.path or log.name, "sha256": log.sha256 or None, "samples": len(log.t),
               "first_sample": int(log.sample[0]), "last_sample": int(log.sample[-1])} for log in source]
    halves = weighted.split_half
    return StoredInformation(*weighted.stored(), mean_phi([half.phi for half in halves]),
                             not any(half.p_value < STEADY for half in halves), weighted.sigma,
                             weighted.correlation_time, weighted.samples, tuple(inputs),
                             (*contradictions(model, problem.experiments), *losses(model, problem.experiments)))


def all_prepared(model: Model, sessions: Sequence[Log | Sequence[Log] | str | Path], smoothing: Smoothing | None,
                 progress: Progress, until: float) -> list[StoredInformation]:
    """The information of every session, no two of which share samples; `until` is the part of all work that this is.

    Raises:
        LogError, IdentifiabilityError, ProblemError: see `stored_information` and `refuse_shared_samples`.
    """
    found = []
    for k, each in enumerate(sessions):
        progress(f"preparing session {k + 1} of {len(sessions)}", until * k / len(sessions))
        found.append(stored_information(model, each, smoothing))
    for one, other in combinations(found, 2):
        refuse_shared_samples(one, other)
    return found


def refuse_shared_samples(before: StoredInformation, after: StoredInformation) -> None:
    """Refuse samples that belong to both sessions: they would hide every change.

    Raises:
        ProblemError: naming the log.
    """
    for one in after.inputs:
        for other in before.inputs:
            if (one["sha256"] and one["sha256"] == other["sha256"] and one["first_sample"] <= other["last_sample"]
                    and other["first_sample"] <= one["last_sample"]):
                raise ProblemError("the same samples are in both sessions", where=str(one["path"]),
                                   remedy="give another log on one side")


def mean_phi(values: Sequence[float | None]) -> float:
    """φ of several logs together, at least 1."""
    known = [value for value in values if value is not None and np.isfinite(value)]
    return max(1.0, float(np.mean(known))) if known else 1.0


def information_csv(machine: Machine, names: Sequence[str], triangles: Array, freedom: Array) -> str:
    """The content of information.csv: rows of the triangles, a column per parameter, numbers in full."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_header(names))
    for owner, triangle, of_rows in zip(_owners(machine, len(triangles)), triangles, freedom, strict=True):
        writer.writerows([owner, *(value or 0 for value in row), own or 0]
                         for row, own in zip(triangle.tolist(), of_rows.tolist(), strict=True))
    return text.getvalue()


def _header(names: Sequence[str]) -> list[str]:
    return ["actuator", *names, "force", "degrees_of_freedom"]


def _owners(machine: Machine, triangles: int) -> list[str]:
    """The balance of each triangle, or ``all`` for a joint one."""
    return [balance.name for balance in machine.balances] if triangles == len(machine.balances) else ["all"]


def _read(model: Model, folder: Path) -> StoredInformation:
    estimate = load(folder)
    if estimate.job is not Job.IDENTIFICATION:
        raise ProblemError(f"this is a {estimate.job}, not an identification of bodies and friction", where=str(folder),
                           remedy="name the folder that `hydroopt identify` wrote, or the logs")
    if estimate.status is Status.FAILED:
        raise ProblemError("the estimate failed, so that there is nothing to compare with", where=str(folder),
                           remedy="identify again, or give the logs")
    if estimate.machine_id.sha256 != model.machine.sha256:
        raise ProblemError("the estimate is of another machine description", where=str(folder),
                           remedy="give the machine file (and --set) that it was identified with, or identify again "
                                  "without --friction, or give the logs")
    text = estimate.text_of(INFORMATION)
    if text is None:
        raise ProblemError(f"there is no {INFORMATION} beside the estimate", where=str(folder),
                           remedy="identify again with this version, or give the logs")
    triangles, freedom = _triangles(model, text, folder / INFORMATION)
    details = estimate.details()
    try:
        weights = [details["weights"][balance.name] for balance in model.machine.balances]
        sigma, times, samples = (np.array([float(w[key]) for w in weights])
                                 for key in ("sigma", "correlation_time", "samples"))
        inputs = [{key: one[key] for key in ("path", "sha256", "samples", "first_sample", "last_sample")}
                  for one in estimate.inputs if one["role"] == "train"]
        halves = details["split_half"]
        phi = mean_phi([one["phi"] for one in halves])
        steady = not any((one["p_value"] or 1.0) < STEADY for one in halves)
    except (ValueError, KeyError, TypeError):
        raise not_an_answer(folder) from None
    return StoredInformation(triangles, freedom, phi, steady, sigma, times, samples, tuple(inputs),
                             tuple(each for each in estimate.diagnostics if "log" in each.evidence))


def _triangles(model: Model, text: str, file: Path) -> tuple[Array, Array]:
    rows = list(csv.reader(io.StringIO(text)))
    names, p = model.parameters.names, len(model.parameters)
    if not rows or rows[0] != _header(names):
        raise ProblemError("its columns are not the parameters of this machine", where=str(file),
                           remedy="identify again, without --reduced, or give the logs")
    owners = [owner for owner in _owners(model.machine, len(rows) // (p + 1)) for _ in range(p + 1)]
    try:
        if [row[0] for row in rows[1:]] != owners:
            raise ValueError
        table = np.array([[float(cell) for cell in row[1:]] for row in rows[1:]]).reshape(-1, p + 1, p + 2)
        triangles, freedom = table[:, :, :-1], table[:, :, -1]
        if not (np.all(np.isfinite(triangles)) and np.all(freedom > 0)):
            raise ValueError
    except ValueError:
        raise ProblemError("it is damaged", where=str(file), remedy="identify again, or give the logs") from None
    return triangles, freedom
