"""The folder that an identification leaves: estimate.json, calibrated machine, report and tables."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import platform
import tempfile
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt.description import dump_machine
from hydroopt.errors import HydrooptError, ProblemError
from hydroopt.estimation.calibrated import calibrated_machine
from hydroopt.estimation.estimate import Estimate
from hydroopt.estimation.experiment import Experiment
from hydroopt.estimation.problem import Problem
from hydroopt.estimation.verdict import doubts
from hydroopt.report import html

SCHEMA = 1
"""Version of estimate.json; it changes when a key changes its meaning or goes."""


def save(estimate: Estimate, directory: str | Path, *, wall_s: float = float("nan")) -> dict[str, Any]:
    """Write everything about an estimate; each file appears complete or not at all, estimate.json last.

    Args:
        estimate: what to write.
        directory: created if need be.
        wall_s: how long it took.

    Returns:
        The content of estimate.json.

    Raises:
        ProblemError: the directory cannot be written.
    """
    content = as_dict(estimate, wall_s)
    machine_file = f"{estimate.problem.model.machine.name}.toml"
    files = {"report.html": html.render(estimate, doubts(estimate)),
             "parameters.csv": _csv([row | dict(zip(("low", "high"), row.pop("ci95") or (None, None), strict=True))
                                     for row in map(dict, content["parameters"])]),
             "base_parameters.csv": _csv(content["base_parameters"]),
             "fit.csv": _csv([{"data": data, "channel": channel} | fit for data, table in content["fit"].items()
                              for channel, fit in table.items()])}
    with contextlib.suppress(ProblemError):  # the doubts and the report say which body cannot exist
        files[machine_file] = dump_machine(calibrated_machine(estimate))
    _forget(directory, machine_file)
    write_files(directory, files | {"estimate.json": json.dumps(content, indent=1, allow_nan=False)})
    return content


def _forget(directory: str | Path, machine_file: str) -> None:
    """Remove an earlier result from the directory, so that none of it is taken for part of the next."""
    for name in ("estimate.json", "report.html", "parameters.csv", "base_parameters.csv", "fit.csv", machine_file):
        with contextlib.suppress(OSError):  # not there, or the directory is no directory, which writing will say
            (Path(directory) / name).unlink()


def save_failure(problem: Problem, method: str, error: HydrooptError, directory: str | Path) -> dict[str, Any]:
    """Write an estimate.json that says why there is no estimate; nothing else.

    Raises:
        ProblemError: the directory cannot be written.
    """
    content = _origin(problem, method) | {"status": "failed", "reason": str(error)}
    _forget(directory, f"{problem.model.machine.name}.toml")
    write_files(directory, {"estimate.json": json.dumps(content, indent=1, allow_nan=False)})
    return content


def write_files(directory: str | Path, files: dict[str, str]) -> None:
    """Write text files into a directory, each first under a temporary name.

    Raises:
        ProblemError: the directory or a file cannot be written.
    """
    target = Path(directory)
    try:
        target.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target, prefix=".unfinished-") as temporary:
            for name, text in files.items():
                (Path(temporary) / name).write_text(text, encoding="utf-8")
            for name in files:
                os.replace(Path(temporary) / name, target / name)
    except OSError as error:
        raise ProblemError(f"cannot be written ({error.strerror})", where=str(directory),
                           remedy="choose another directory with -o") from None


def as_dict(estimate: Estimate, wall_s: float = float("nan")) -> dict[str, Any]:
    """The content of estimate.json; numbers that do not exist are null."""
    seen, parameters = estimate.seen, estimate.problem.parameters
    rows = [{"name": name, "unit": parameters.units[k], "nominal": float(parameters.nominal[k]),
             "value": _number(estimate.value[k]), "std": _number(estimate.std[k]),
             "ci95": [float(v) for v in estimate.ci95[k]] if np.all(np.isfinite(estimate.ci95[k])) else None,
             "bound": estimate.bound[k] or None, "identifiability": estimate.identifiability(k)}
            for k, name in enumerate(parameters.names)]
    base = [{"expression": seen.expression(i), "unit": parameters.units[seen.basis[i]],
             "value": _number(estimate.base_value[i]), "std": _number(estimate.base_std[i])} for i in range(seen.rank)]
    fit = {data: {channel: {"rms": _number(one.rms), "vaf": _number(one.vaf), "relative": _number(one.relative),
                            "unit": one.unit} for channel, one in table.items()}
           for data, table in estimate.fit.items()}
    structure, model = estimate.structure, estimate.problem.model
    return _origin(estimate.problem, estimate.method) | {
        "status": estimate.status, "parameters": rows, "base_parameters": base, "fit": fit,
        "conditioning": {"rank": seen.rank, "condition_number": _number(seen.condition_number),
                         "parameters": len(estimate.problem.parameters), "structural_rank": structure.rank,
                         "structurally_identifiable": structure.count("full"),
                         "structurally_in_combination": structure.count("combination"),
                         "structurally_invisible": structure.count("none")},
        "physical_consistency": {owner: {"consistent": smallest >= 0, "min_eigenvalue": smallest}
                                 for owner, smallest in estimate.consistency.items()},
        "weights": {actuator.name: {"sigma": float(sigma), "unit": unit, "correlation_time": float(time)}
                    for actuator, sigma, unit, time in zip(model.machine.actuators, estimate.sigma, model.force_units,
                                                           estimate.correlation_time, strict=True)},
        "active_constraints": list(estimate.active), "doubts": list(doubts(estimate)), "notes": list(estimate.notes),
        "seed": estimate.seed, "wall_s": _number(wall_s)}


def _origin(problem: Problem, method: str) -> dict[str, Any]:
    machine = problem.model.machine
    packages = ("hydroopt", "casadi", "clarabel", "cvxpy", "numpy", "scipy")
    return {"schema": SCHEMA, "machine": {"name": machine.name, "parameter_set": machine.parameter_set,
                                          "sha256": machine.sha256},
            "inputs": [_input(e, "train") for e in problem.experiments] + [_input(e, "validation")
                                                                          for e in problem.validation],
            "method": method,
            "versions": {"python": platform.python_version()} | {p: metadata.version(p) for p in packages}}


def _input(data: Experiment, role: str) -> dict[str, Any]:
    log = data.log
    return {"path": log.path or log.name, "sha256": log.sha256 or None, "samples": len(log.t), "role": role,
            "first_sample": int(log.sample[0]), "last_sample": int(log.sample[-1]),
            "findings": [f.text for f in log.findings], "notes": list(data.notes)}


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
