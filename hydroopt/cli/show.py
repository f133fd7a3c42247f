"""`hydroopt show`: what there is to know of a machine before any log."""

from __future__ import annotations

import json
from typing import Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hydroopt.cli.options import AsJson, MachineName, ParameterSetName
from hydroopt.description import load_machine
from hydroopt.report.facts import machine_facts


def show(machine: MachineName, parameter_set: ParameterSetName = None, as_json: AsJson = False) -> None:
    """Show a machine: links, actuators with their geometry, sensors, and which parameters a motion can reveal."""
    described = load_machine(machine, parameter_set=parameter_set)
    facts = machine_facts(described)
    if as_json:
        typer.echo(json.dumps(facts, indent=1))
        return
    console = Console()
    console.print(f"[bold]{described.name}[/bold] {escape(described.description)}")
    console.print(_table("Joints", facts["joints"]),
                  _table("Cylinders", [_cylinder_row(cylinder) for cylinder in facts["cylinders"]]),
                  _table("Sensors (standard deviation of a reading)", facts["sensors"]),
                  _table("Parameters", facts["parameters"]))
    seen = facts["identifiability"]
    console.print(f"Of {len(facts['parameters'])} parameters a motion without noise shows {seen['full']} alone and "
                  f"{seen['combination']} in combination ({seen['rank']} base parameters); {seen['none']} leave "
                  "no trace.")
    if lines := facts["calibration"]["lines"]:
        console.print("[bold]Kinematic calibration[/bold]")
        for line in lines:
            console.print(escape(line), soft_wrap=True)


def _cylinder_row(facts: dict[str, Any]) -> dict[str, Any]:
    """The same for a screen, in fewer columns."""
    return {"cylinder": facts["cylinder"], "joint": facts["joint"],
            "areas [cm²]": f"{facts['head_area_cm2']:.1f} / {facts['rod_area_cm2']:.1f}",
            "length [m]": f"{facts['length_min_m']:.3f} … {facts['length_max_m']:.3f}",
            "lever arm [m]": f"{facts['lever_arm_min_m']:.3f} … {facts['lever_arm_max_m']:.3f}"}


def _table(title: str, rows: Any) -> Table:
    table = Table(title=title, title_justify="left", header_style="bold")
    for key in rows[0] if rows else ():
        table.add_column(escape(key), no_wrap=True)
    for row in rows:
        table.add_row(*[f"{v:.6g}" if isinstance(v, float) else str(v) for v in row.values()])
    return table
