"""The folder that a command leaves: estimate.json, calibrated machine, report and tables, or a motion to drive."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt.errors import HydrooptError
from hydroopt.estimation.dynamic import stored_information
from hydroopt.estimation.kinematic.calibration import Calibration
from hydroopt.estimation.kinematic.diagnostics import Appraisal
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.estimation.kinematic.suspects import Suspect
from hydroopt.files import write_files
from hydroopt.logs.poses import Poses
from hydroopt.report import calibration as calibration_page
from hydroopt.report.record import SCHEMA
from hydroopt.report.record import flat as _flat
from hydroopt.report.record import machine_entry as _machine
from hydroopt.report.record import now as _now
from hydroopt.report.record import number as _number
from hydroopt.report.record import table as _csv
from hydroopt.results.fit import Fit
from hydroopt.versions import versions


def forget(directory: str | Path, machine_file: str) -> None:
    """Remove an earlier result from the directory, so that none of it is taken for part of the next."""
    for name in ("estimate.json", "report.html", "parameters.csv", "base_parameters.csv", "fit.csv", "residuals.csv",
                 "free_run.csv", stored_information.INFORMATION, machine_file):
        with contextlib.suppress(OSError):  # not there, or the directory is no directory, which writing will say
            (Path(directory) / name).unlink()


def save_calibration(calibration: Calibration, directory: str | Path, *, wall_s: float = float("nan"), seed: int = 0,
                     before: Calibration | None = None) -> dict[str, Any]:
    """Write everything about a kinematic calibration; each file appears complete or not at all, estimate.json last.

    Args:
        calibration: what to write.
        directory: created if need be.
        wall_s: how long it took.
        seed: of its starts, and of the workspace that the report shows.
        before: the calibration with all poses, if those that did not fit were left out.

    Returns:
        The content of estimate.json.

    Raises:
        ProblemError: the directory cannot be written.
    """
    appraisal = Appraisal(calibration, before, seed)
    content = calibration_as_dict(appraisal, wall_s)
    machine_file = f"{calibration.problem.model.machine.name}.toml"
    files = {"report.html": calibration_page.render(appraisal),
             "parameters.csv": _csv([_flat(row) for row in content["parameters"]]),
             "fit.csv": _fit_csv(content["fit"]), "residuals.csv": _csv(_residual_rows(appraisal))}
    if appraisal.machine_text[0]:
        files[machine_file] = appraisal.machine_text[0]
    forget(directory, machine_file)
    write_files(directory, files | {"estimate.json": json.dumps(content, indent=1, allow_nan=False)})
    return content


def save_failure(problem: CalibrationProblem, method: str, error: HydrooptError,
                 directory: str | Path) -> dict[str, Any]:
    """Write an estimate.json that says why there is no estimate; nothing else.

    Raises:
        ProblemError: the directory cannot be written.
    """
    content = _origin(problem, method) | {"status": "failed", "reason": str(error)}
    forget(directory, f"{problem.model.machine.name}.toml")
    write_files(directory, {"estimate.json": json.dumps(content, indent=1, allow_nan=False)})
    return content


def calibration_as_dict(appraisal: Appraisal, wall_s: float = float("nan")) -> dict[str, Any]:
    """The content of a calibration's estimate.json; numbers that do not exist are null."""
    c, seen = appraisal.calibration, appraisal.calibration.seen
    rank = seen.rank
    std = 1e3 * appraisal.workspace.std[np.isfinite(appraisal.workspace.std)]
    return _origin(c.problem if appraisal.before is None else appraisal.before.problem, c.method) | {
        "status": c.status, "parameters": [_calibrated(c, k) for k in range(len(c.theta))], "base_parameters": [],
        "combinations": [{"parameters": list(group)} for group in appraisal.combinations], "fit": _fits(c.fit),
        "conditioning": {"rank": rank, "condition_number": _number(seen.condition_number),
                         "noise_amplification_index": _number(seen.noise_amplification_index),
                         "parameters": len(seen.names),
                         "degrees_of_freedom": int(c.at.rank.sum()) + len(c.problem.distances.length) - rank},
        "noise_scale": _number(c.noise_scale), "suspects": [_suspect(c.problem.poses, s) for s in c.suspects],
        "left_out": [_suspect(appraisal.before.problem.poses, s) for s in appraisal.left_out if appraisal.before],
        "uniqueness": c.uniqueness,
        "tip_uncertainty": {"point": appraisal.workspace.point,
                            "median_mm": float(np.median(std)) if std.size else None,
                            "max_mm": float(np.max(std)) if std.size else None},
        "physical_consistency": {}, "doubts": list(appraisal.doubts), "seed": appraisal.seed, "wall_s": _number(wall_s)}


def _calibrated(c: Calibration, k: int) -> dict[str, Any]:
    """One parameter; without a value where neither the poses nor a prior tell it."""
    parameters = c.problem.parameters
    name, unit = parameters.names[k], parameters.units[k]
    told, other, correlation = True, "", float("nan")
    if c.problem.free[k]:
        at = c.seen.names.index(name)
        told = bool(np.isfinite(c.seen.covariance[at, at]))
        other, correlation = c.seen.strongest(at)
    bound = None
    if c.at_bound[k]:
        low = c.theta[k] - parameters.lower[k] < parameters.upper[k] - c.theta[k]
        bound = f"{name} {'>=' if low else '<='} {parameters.lower[k] if low else parameters.upper[k]:.9g} {unit}"
    return {"name": name, "unit": unit, "nominal": float(parameters.nominal[k]),
            "value": float(c.theta[k]) if told else None, "std": _number(c.std[k]) if told else None,
            "ci95": [float(v) for v in c.ci95[k]] if told and np.all(np.isfinite(c.ci95[k])) else None,
            "bound": bound, "identifiability": c.category(name),
            "correlated_with": {"name": other, "correlation": correlation} if np.isfinite(correlation) else None}


def _suspect(poses: Poses, suspect: Suspect) -> dict[str, Any]:
    """`rows` are the files' data rows, `poses` the positions from 1 among the poses of this role."""
    return {"kind": suspect.kind, "name": suspect.name, "text": suspect.text, "strength": _number(suspect.strength),
            "rows": poses.row[suspect.poses].tolist(), "poses": (np.flatnonzero(suspect.poses) + 1).tolist(),
            "paths": list(dict.fromkeys(map(str, poses.file[suspect.poses])))}


def _residual_rows(appraisal: Appraisal) -> list[dict[str, Any]]:
    """One row per pose: what it leaves open [m] at the nominal and at the calibrated geometry."""
    rows = []
    channels = list(dict.fromkeys(channel for part in appraisal.residuals for channel in part.after))
    nothing = np.array(np.nan)
    for part in appraisal.residuals:
        for k in range(len(part.poses)):
            poses = part.poses
            row: dict[str, Any] = {"data": part.role, "path": str(poses.file[k]), "row": int(poses.row[k]),
                                   "stage": str(poses.stage[k]), "fixture": str(poses.fixture[k]),
                                   "pose": str(poses.pose[k]),
                                   "suspect": int(part.role == "train" and appraisal.suspicious[k])}
            for channel in channels:
                for when, table in (("before", part.before), ("after", part.after)):
                    row[f"{channel}_{when} [m]"] = _number(table[channel][k] if channel in table else nothing)
            rows.append(row)
    return rows


def _origin(problem: CalibrationProblem, method: str) -> dict[str, Any]:
    return {"schema": SCHEMA, "machine": _machine(problem.model.machine), "created": _now(), "inputs": _tables(problem),
            "method": method, "versions": versions()}


def _tables(problem: CalibrationProblem) -> list[dict[str, Any]]:
    roles = (("train", problem.poses), ("validation", problem.validation))
    return [{"path": path or poses.name, "sha256": poses.sha256.get(path), "samples": int(np.sum(poses.file == path)),
             "role": role, "findings": []}
            for role, poses in roles if poses is not None for path in dict.fromkeys(map(str, poses.file))]


def _fits(fit: Mapping[str, Mapping[str, Fit]]) -> dict[str, dict[str, dict[str, Any]]]:
    return {data: {channel: {"rms": _number(one.rms), "vaf": _number(one.vaf), "relative": _number(one.relative),
                             "unit": one.unit} for channel, one in table.items()} for data, table in fit.items()}


def _fit_csv(fit: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> str:
    return _csv([{"data": data, "channel": channel, **one} for data, table in fit.items()
                 for channel, one in table.items()])
