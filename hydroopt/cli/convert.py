"""`hydroopt convert`: a machine from one format to another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.options import MachineOrFolder, ParameterSetName, Quiet
from hydroopt.cli.terminal import echo


def convert(
    machine: MachineOrFolder,
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write; its ending names the format.")],
    tip: Annotated[str | None, typer.Option(metavar="LINK", help=(
        "Of a robot file, the link at the end of the chain to read; all joints if not given."))] = None,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
) -> None:
    """Convert a machine or a calibrated estimate from one format to another: .toml, .urdf, .xml (MJCF)."""
    from hydroopt.codegen.parameter_source import read
    from hydroopt.files import write_files
    from hydroopt.input_file import is_directory
    from hydroopt.machine.machine_file import ROBOT_SUFFIXES, load_machine
    from hydroopt.machine.robot_formats.reading import read_robot
    from hydroopt.machine.robot_formats.writing import robot_files

    described = (read(machine, parameter_set=parameter_set)[0] if is_directory(machine) else
                 load_machine(machine, parameter_set=parameter_set, tip=tip))
    written = robot_files(described, target)
    write_files(target.parent, written.files)
    if not quiet:
        echo(f"{', '.join(str(target.parent / name) for name in written.files)}")
        if Path(machine).suffix in ROBOT_SUFFIXES:
            for lost in read_robot(machine, tip=tip).lost:
                echo(f"not in {Path(machine).name}'s machine: {lost}")
        for lost in written.lost:
            echo(f"not in {target.name}: {lost}")
