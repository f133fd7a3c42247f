"""The folder that `hydroopt control` leaves: control.json, report, tables and the best feedforward as C."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt.codegen.folder import Code
from hydroopt.codegen.parameter_source import Origin
from hydroopt.control.comparison import Comparison, Outcome
from hydroopt.control.diagnostics import doubts
from hydroopt.control.model_variants import Knowledge
from hydroopt.control.sampled import Margin
from hydroopt.errors import ProblemError
from hydroopt.files import write_files
from hydroopt.logs.table import write_columns
from hydroopt.report import closed_loop
from hydroopt.report.record import SCHEMA, machine_entry, now, number, table
from hydroopt.spatial.inertia import Array
from hydroopt.versions import versions

FILES = ("control.json", "report.html", "tracking.csv", "margins.csv", "runs.csv")
"""Files that the next comparison replaces."""


def save(comparison: Comparison, directory: str | Path, *, origin: Origin, asked: Mapping[str, Any],
         wall_s: float = float("nan")) -> dict[str, Any]:
    """Write a comparison of controllers; each file appears complete or not at all, control.json last.

    Args:
        comparison: what to write.
        directory: created if need be.
        origin: what the machine was read from.
        asked: options to be kept in control.json.
        wall_s: how long it took.

    Returns:
        The content of control.json.

    Raises:
        ProblemError: the directory cannot be written, or holds C that hydroopt did not generate.
    """
    where, setting, said = Path(directory), comparison.setting, doubts(comparison)
    machine = setting.plant.machine
    content = {
        "schema": SCHEMA, "machine": machine_entry(machine), "origin": origin.text, "created": now(),
        "versions": versions("control"), **asked, "rate": setting.rate,
        "truth_text": setting.true.text,
        "gains": [{"actuator": each.actuator.name, "position": float(comparison.gains.position[k]),
                   "force": float(comparison.gains.force[k]), "integral_time": float(comparison.gains.integral_time[k]),
                   "filter_time": float(comparison.gains.filter_time[k])}
                  for k, each in enumerate(setting.plant.actuators)],
        "winner": comparison.winner.name, "candidates": [_outcome(comparison, each) for each in comparison.outcomes],
        "doubts": list(said), "wall_s": number(wall_s)}
    rows = [{"controller": outcome.name, "parameters": outcome.knowledge.name, **row}
            for outcome in comparison.outcomes for row in _joints(comparison, outcome)]
    margins = [{"controller": outcome.name, **_margin(margin)}
               for outcome in comparison.outcomes for margin in outcome.margins]
    page = closed_loop.render(comparison, said, origin)
    refuse_directory(where)
    best = comparison.feedforward
    if best is not None:
        code = Code(machine, Origin(f"{best.knowledge.text} ({best.knowledge.name})", origin.sha256),
                    routines=["valve_feedforward"], psi=_complete(setting.plant.model.parameters.names, best.knowledge))
        code.write(where / "c")
    for name in FILES:
        (where / name).unlink(missing_ok=True)
    _write_runs(comparison, where / "runs.csv")
    write_files(where, {"report.html": page, "tracking.csv": table(rows), "margins.csv": table(margins),
                        "control.json": json.dumps(content, indent=1, allow_nan=False)})
    return content


def _complete(names: tuple[str, ...], knowledge: Knowledge) -> Array:
    """Parameters ψ (p,) of the complete model that make the same forces: zero for bodies that a reduced one lacks."""
    own = knowledge.model.parameters.positions
    return np.array([knowledge.psi[own[name]] if name in own else 0.0 for name in names])


def _write_runs(comparison: Comparison, file: Path) -> None:
    """Reference, positions and commands of all candidates that reached the end."""
    setting = comparison.setting
    machine, plant = setting.plant.machine, setting.plant
    columns = {"t [s]": setting.t}
    for k, joint in enumerate(machine.joints):
        columns[f"{joint}.q [{machine.channel_units[f'{joint}.q']}]"] = comparison.reference[:, k]
    for outcome in comparison.outcomes:
        if outcome.run.stopped:
            continue
        start = outcome.name.replace(" ", "_")
        for k, joint in enumerate(machine.joints):
            columns[f"{start}.{joint}.q [{machine.channel_units[f'{joint}.q']}]"] = outcome.run.q[:, k]
        for k, name in enumerate(plant.inputs):
            columns[f"{start}.{name} [{plant.actuators[k].valve.command}]"] = outcome.run.u[:, k]
    write_columns(file, columns, "runs")


def refuse_directory(directory: Path) -> None:
    """Refuse a directory that cannot take the result, before it is reckoned.

    Raises:
        ProblemError: it is a file, or holds a directory where a file has to be.
    """
    if directory.exists() and not directory.is_dir():
        raise ProblemError("this is a file", where=str(directory), remedy="choose another directory with -o")
    for name in FILES:
        if (directory / name).is_dir():
            raise ProblemError("this is a directory", where=str(directory / name),
                               remedy="choose another directory with -o")


def _outcome(comparison: Comparison, outcome: Outcome) -> dict[str, Any]:
    run = outcome.run
    return {"name": outcome.name, "kind": outcome.kind, "parameters": outcome.knowledge.name,
            "from": outcome.knowledge.text, "stopped": run.stopped or None,
            "tip": {"rms": number(outcome.tip_rms), "max": number(np.max(outcome.tip)), "unit": "m"},
            "joints": _joints(comparison, outcome), "peak_pressure": float(np.max(run.pressure)),
            "lowest_supply": float(np.min(run.p_supply)), "energy": run.energy,
            "loops": [{"actuator": each.actuator.name} | {
                f"least_{key}_margin": _margin(outcome.worst(each.actuator.name, key)) for key in ("gain", "phase")}
                for each in comparison.setting.plant.actuators]}


def _joints(comparison: Comparison, outcome: Outcome) -> list[dict[str, Any]]:
    machine = comparison.setting.plant.machine
    return [{"joint": joint, "unit": machine.channel_units[f"{joint}.q"],
             "rms": float(np.sqrt(np.mean(outcome.error[:, k] ** 2))),
             "max": float(np.max(np.abs(outcome.error[:, k]))),
             "actuator": each.actuator.name, "peak_pressure": float(np.max(outcome.run.pressure[:, k]))}
            for k, (joint, each) in enumerate(zip(machine.joints, comparison.setting.plant.actuators, strict=True))]


def _margin(margin: Margin) -> dict[str, Any]:
    return {"loop": margin.loop, "point": margin.point, "gain_margin_db": number(20 * np.log10(margin.gain)),
            "gain_crossing_hz": number(margin.gain_at / (2 * np.pi)),
            "phase_margin_deg": number(np.degrees(margin.phase)),
            "phase_crossing_hz": number(margin.phase_at / (2 * np.pi)), "sensitivity": number(1 / margin.distance),
            "damping": margin.damping}
