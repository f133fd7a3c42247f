"""`hydroopt excite`: what to measure."""

from __future__ import annotations

import json
import math
from typing import Annotated

import typer

from hydroopt.cli.options import AsJson, Directory, MachineName, Quiet, progress
from hydroopt.description import load_machine
from hydroopt.excitation.poses import plan_poses
from hydroopt.files import write_files


def excite(
    machine: MachineName,
    output: Directory,
    poses: Annotated[int, typer.Option(help="Poses to measure in each stage.", min=1)],
    focus: Annotated[list[str] | None, typer.Option(help="A parameter that matters most; repeatable.")] = None,
    seed: Annotated[int, typer.Option(help="Of the postures to choose from.", min=0)] = 0,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Plan the poses of a kinematic calibration: DIR gets sheet.txt, poses.csv and plan.json."""
    described = load_machine(machine)
    with progress(f"choosing poses for {described.name}", quiet):
        plan = plan_poses(described, poses, focus=focus or (), seed=seed)
    content = {"machine": {"name": described.name, "sha256": described.sha256}, "poses": len(plan.q), "seed": seed,
               "expected": [{"name": name, "unit": unit, "std": float(std) if math.isfinite(std) else None}
                            for name, unit, std in zip(plan.names, plan.units, plan.std, strict=True)],
               "condition_number": plan.condition_number, "log_det": plan.log_det,
               "noise_amplification_index": plan.noise_amplification_index}
    write_files(output, {"sheet.txt": plan.sheet()})
    plan.write(output / "poses.csv")
    write_files(output, {"plan.json": json.dumps(content, indent=1, allow_nan=False)})
    if as_json:
        typer.echo(json.dumps(content, indent=1))
    elif not quiet:
        typer.echo(plan.sheet())
