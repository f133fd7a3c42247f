"""`hydroopt show`: what a machine file says, and which parameters a motion can identify."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hydroopt.cli.run import Run, command
from hydroopt.cli.terminal import echo, print_table
from hydroopt.errors import visible

if TYPE_CHECKING:
    from hydroopt.machine.machine import Machine

ROWS = 12
"""Rows of a table, or lines of a list, that are shown; what is left out is counted."""
UNKNOWN = 0.25
"""Standard deviation of a joint's position, as a part of its range, beyond which it is not determined."""


@command("parameter_set", "force", "as_json")
def show(
    run: Run,
    hydraulics: Annotated[bool, typer.Option("--hydraulics", help=(
        "Show frequency, damping and gain of every joint on its oil over the workspace."))] = False,
    output: Annotated[Path | None, typer.Option("-o", "--output", help=(
        "Directory that receives everything: machine.html, or with --hydraulics hydraulics.html and .csv."))] = None,
    motion: Annotated[Path | None, typer.Option("--motion", metavar="LOG", help=(
        "Log whose joint positions are followed, such as excite's trajectory.csv; what IMUs determine is that of this "
        "motion, or of a random one if not given."))] = None,
    frames: Annotated[bool, typer.Option("--frames", help=(
        "Of a robot file, show where the frame of each link is in the frame that the robot file has of it."))] = False,
    everything: Annotated[bool, typer.Option("--all", help=(
        "Show every channel and parameter, and what each stage of the calibration identifies."))] = False,
) -> None:
    """Show a machine on one page: joints, cylinders and their geometry, sensors, what motion identifies.

    Example: hydroopt show cat215b -o out
    """
    from rich.console import Console
    from rich.markup import escape

    from hydroopt.cli.machine_facts import machine_facts
    from hydroopt.logs.log_files import read_log
    from hydroopt.simulation.reference_motion import reference_motion

    if frames:
        _frames(run)
        return
    described = run.machine
    if hydraulics:
        _hydraulics(run, output)
        return
    facts = machine_facts(described, None if motion is None else reference_motion(described, read_log(motion)))
    if output is not None:
        _page(described, facts, output)
    if run.as_json:
        echo(json.dumps(facts, indent=1))
        return
    console = Console()
    console.print(f"[bold]{described.name}[/bold] {escape(visible(described.description, keep=chr(10)))}")
    for diagnostic in facts["diagnostics"]:
        console.print(f"! {escape(diagnostic['text'])} {escape(diagnostic['remedy'])}", soft_wrap=True)
    for title, rows in _tables(facts, everything=everything).items():
        shown, more = (rows, "") if everything else _shortened(rows)
        if shown:
            print_table(title, shown)
        if more:
            console.print(f"  {more}", markup=False)
    for line in _lines(facts, everything=everything):
        console.print(line, soft_wrap=everything, markup=False, highlight=False)
    if output is not None:
        echo(f"{output / 'machine.html'}")


def _frames(run: Run) -> None:
    from hydroopt.errors import ProblemError
    from hydroopt.machine.machine_file import ROBOT_SUFFIXES
    from hydroopt.machine.robot_formats.machine_tables import FRAMES
    from hydroopt.machine.robot_formats.reading import read_robot

    if Path(run.named).suffix not in ROBOT_SUFFIXES:
        raise ProblemError("its frames are those of no robot file", where=run.named,
                           remedy=f"name the {', '.join(ROBOT_SUFFIXES[:3])} file that it was converted from")
    rows = read_robot(run.named).frames
    if run.as_json:
        echo(json.dumps(rows, indent=1))
    else:
        print_table(FRAMES, rows)


def _tables(facts: dict[str, Any], *, everything: bool) -> dict[str, list[dict[str, Any]]]:
    """The tables of the screen by their titles."""
    cylinders = [_cylinder_row(cylinder) for cylinder in facts["cylinders"]]
    if not everything:
        return {"Joints": facts["joints"], "Cylinders": cylinders,
                "Sensors (standard deviation of a reading)": _alike_sensors(facts["sensors"]),
                "Parameters that motion identifies (alone; combined with others; not at all)":
                _parts(facts["parameters"])}
    tables = {"Joints": facts["joints"], "Cylinders": cylinders,
              "Sensors (standard deviation of a reading)": facts["sensors"], "Parameters": facts["parameters"],
              "Hydraulic parameters": facts["hydraulic_parameters"]}
    if facts["imus"]:
        tables[f"IMUs: what {facts['imus']['motion']} determines (standard deviations)"] = facts["imus"]["numbers"]
    return tables


def _lines(facts: dict[str, Any], *, everything: bool) -> list[str]:
    """The sentences below the tables."""
    counts, imus, hydraulic = facts["identifiability"], facts["imus"], facts["hydraulic_parameters"]
    relations = [f"{each['coupling']}: {each['relation']}" for each in facts["couplings"]]
    relations += [f"{each['cylinders']} together move {each['joints']}; least angle to a singular posture "
                  f"{each['margin_deg']:.1f} deg, at {each['margin_at']}" for each in facts["spans"]]
    relations += [f"{each['linkage']}: {each['dependent']} follow {each['follows']}; speed ratios {_ratios(each)}; "
                  f"least angle to a dead point {each['margin_deg']:.1f} deg, at {each['margin_at']}"
                  for each in facts["linkages"]]
    relations += [f"{each['linkage']}: {each['assembly']}" for each in facts["linkages"] if each["assembly"]]
    lines = [f"Of {len(facts['parameters'])} parameters a motion without noise identifies {counts['full']} "
             f"individually and {counts['combination']} in combinations ({counts['rank']} base parameters); "
             f"{counts['none']} have no effect on the actuator forces.", *relations]
    if imus:
        motion = imus["motion"]
        lines.append(f"Positions of joints by {motion}: " + ", ".join(map(_position, imus["joints"])) + ".")
    calibration = facts["calibration"]["lines"]
    if everything:
        return [*lines, *(["Kinematic calibration"] if calibration else []), *calibration]
    if imus:
        determined = sum(each["determined"] == "yes" for each in imus["numbers"])
        lines.append(f"That motion determines {determined} of {len(imus['numbers'])} numbers of the IMUs.")
    lines += [line for line in (_hydraulic_numbers(hydraulic), _calibration(calibration)) if line]
    return [*lines, "Each parameter and channel: --all. A drawing: -o DIR."]


def _position(each: dict[str, Any]) -> str:
    """How well a joint's position is known, in words."""
    if each["std"] > UNKNOWN * each["range"]:
        return f"{each['joint']} not determined"
    turns = each["unit"] == "rad"
    value, unit = (math.degrees(each["std"]), "deg") if turns else (1e3 * each["std"], "mm")
    return f"{each['joint']} ±{value:.2g} {unit}"


def _page(machine: Machine, facts: dict[str, Any], output: Path) -> None:
    from hydroopt.model.model import recent_model
    from hydroopt.model.over_range import lever_arms, transmission_ratios
    from hydroopt.model.vertical_plane import limit_postures
    from hydroopt.report import machine as report
    from hydroopt.support.files import write_files

    model = recent_model(machine)
    facts = facts | {"linkages": [each | {"ratios": _ratios(each)} for each in facts["linkages"]]}
    page = report.render(model.scene_graph, facts, limit_postures(model), lever_arms(model),
                         transmission_ratios(model))
    write_files(output, {"machine.html": page})


def _ratios(linkage: dict[str, Any]) -> str:
    """Ranges of a linkage's transmission ratios, in words."""
    return ", ".join(f"{one['ratio']} from {one['min']:.3f} to {one['max']:.3f}"
                     + (one["unit"] != "1") * f" {one['unit']}" for one in linkage["ratios"])


def _hydraulics(run: Run, output: Path | None) -> None:
    from hydroopt.model.model import recent_model
    from hydroopt.model.plant import Plant
    from hydroopt.model.workspace import sweeps
    from hydroopt.report import hydraulics as workspace
    from hydroopt.results.tables import csv_text as csv
    from hydroopt.support.files import write_files

    model = recent_model(run.machine)
    plant = Plant(model)
    with run.progress(f"linearising {run.machine.name}"):
        found = sweeps(plant, model.parameters.nominal, plant.parameters.nominal)
        rows = workspace.rows(plant, found)
        if output is not None:
            write_files(output, {"hydraulics.html": workspace.render(plant, found), "hydraulics.csv": csv(rows)})
    if run.as_json:
        echo(json.dumps(rows, indent=1))
        return
    print_table("Joints on their oil, each moving at a tenth of its greatest speed", [_mode_row(row) for row in rows])
    for row in rows:
        if row["unreachable"]:
            echo(f"{row['joint']} at {row['speed']:.3g} {row['speed_unit']}: no steady motion in "
                       f"{row['unreachable']} postures; in the first, {row['reason']}.")
    if output is not None:
        echo(f"{output / 'hydraulics.html'}")


def _mode_row(row: dict[str, Any]) -> dict[str, Any]:
    """A row for the screen: the values at mid-range, with the least and greatest over the workspace."""
    def cell(key: str) -> str:
        values = (row[key], row[f"{key}_min"], row[f"{key}_max"])
        return "{} ({}…{})".format(*("—" if value is None else f"{value:.3g}" for value in values))

    return {"joint": row["joint"], "speed": f"{row['speed']:.3g} {row['speed_unit']}",
            "frequency [Hz]": cell("frequency"), "damping": cell("damping"),
            "gain": f"{cell('gain')} {row['gain_unit']}"}


def _cylinder_row(facts: dict[str, Any]) -> dict[str, Any]:
    """A row for the screen, in fewer columns."""
    return {"cylinder": facts["cylinder"], "joint": facts["joint"],
            "areas [cm²]": f"{facts['head_area_cm2']:.1f} / {facts['rod_area_cm2']:.1f}",
            "length [m]": f"{facts['length_min_m']:.3f} … {facts['length_max_m']:.3f}",
            "lever arm [m]": f"{facts['lever_arm_min_m']:.3f} … {facts['lever_arm_max_m']:.3f}"}


def _alike_sensors(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One row for all channels of a kind with the same accuracy and rate.

    >>> row = {"unit": "rad", "std": 0.001, "rate_hz": None}
    >>> _alike_sensors([row | {"channel": "boom.q"}, row | {"channel": "arm.q"}])
    [{'channels': 'boom.q, arm.q', 'std': '0.057 deg', 'rate': 'any'}]
    """
    from hydroopt.results.readable import readable

    alike: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        rate = "any" if row["rate_hz"] is None else f"{row['rate_hz']:g} Hz"
        alike.setdefault((readable(row["std"], row["unit"]), rate), []).append(row["channel"])
    return [{"channels": _listed(channels, 3), "std": std, "rate": rate} for (std, rate), channels in alike.items()]


def _parts(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One row for all parameters of a part: its mass, and how many of its parameters motion identifies.

    >>> row = {"name": "boom.m", "unit": "kg", "nominal": 90.0, "prior_std": 9.0, "identifiability": "none"}
    >>> _parts([row, row | {"name": "boom.mc_x", "identifiability": "full"}])
    [{'part': 'boom', 'mass [kg]': '90 ± 9', 'alone': 'mc_x', 'combined': '', 'none': 1}]
    """
    owners: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        owners.setdefault(row["name"].rpartition(".")[0], []).append(row)
    found = []
    for owner, own in owners.items():
        of = {kind: [row["name"].rpartition(".")[2] for row in own if row["identifiability"] == kind]
              for kind in ("full", "combination", "none")}
        mass = next((row for row in own if row["name"] == f"{owner}.m"), None)
        found.append({"part": owner, "mass [kg]": "" if mass is None else f"{mass['nominal']:.5g}" + (
            "" if mass["prior_std"] is None else f" ± {mass['prior_std']:.4g}"), "alone": _listed(of["full"], 3),
            "combined": len(of["combination"]) or "", "none": len(of["none"]) or ""})
    return found


def _hydraulic_numbers(rows: Sequence[Mapping[str, Any]]) -> str:
    """How many hydraulic parameters the machine states, and of what."""
    owners = list(dict.fromkeys(row["name"].rpartition(".")[0] for row in rows))
    return f"{len(rows)} hydraulic parameters are stated, of {_listed(owners, 6)}." if rows else ""


def _calibration(lines: Sequence[str]) -> str:
    """What kinematic calibration there is, without what each stage identifies."""
    heads = [line.partition(":")[0] for line in lines if not line.startswith(" ")]
    return f"Kinematic calibration: {_listed(heads, 4)}." if heads else ""


def _shortened(items: Sequence[Any], most: int = ROWS) -> tuple[Sequence[Any], str]:
    """The first of some rows or lines, and how many more there are, in words; one more than `most` is shown as well."""
    if len(items) <= most + 1:
        return items, ""
    return items[:most], f"… and {len(items) - most} more"


def _listed(names: Sequence[str], most: int) -> str:
    shown, more = _shortened(names, most)
    return ", ".join(shown) + f" {more}" * bool(more)
