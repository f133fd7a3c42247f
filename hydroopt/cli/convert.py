"""`hydroopt convert`: a machine from one format to another, and cylinders in the place of a robot's drives."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hydroopt.cli.options import MachineOrFolder
from hydroopt.cli.run import Run, command
from hydroopt.cli.terminal import echo, print_table
from hydroopt.errors import MachineError, ProblemError

if TYPE_CHECKING:
    from hydroopt.machine.machine import Machine
    from hydroopt.machine.robot_formats.machine_tables import RobotFile

_ASKED = (("bore", "bore, e.g. 100 mm"), ("rod_diameter", "diameter of the rod, e.g. 56 mm"))


@command("parameter_set", "force", "quiet", machine=MachineOrFolder)
def convert(
    run: Run,
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write; its ending names the format.")],
    tip: Annotated[str | None, typer.Option(metavar="LINK", help=(
        "Of a robot file, the link at the end of the chain to read; all joints if not given."))] = None,
    cylinders: Annotated[Path | None, typer.Option(metavar="FILE", help=(
        "Of a robot file, TOML with a table for each cylinder that replaces a drive."))] = None,
    ask: Annotated[bool, typer.Option("--ask-cylinders", help=(
        "Of a robot file, ask joint by joint for a cylinder that replaces its drive."))] = False,
) -> None:
    """Convert a machine or a calibrated estimate from one format to another: .toml, .urdf, .xml (MJCF), .sdf.

    Example: hydroopt convert robot.urdf robot.toml
    """
    from hydroopt.codegen.parameter_source import read
    from hydroopt.machine.machine_file import ROBOT_SUFFIXES, load_machine
    from hydroopt.machine.robot_formats.machine_tables import FRAMES
    from hydroopt.machine.robot_formats.reading import read_robot
    from hydroopt.machine.robot_formats.writing import robot_files
    from hydroopt.support.files import write_files

    machine = run.named
    robot = read_robot(machine, tip=tip) if Path(machine).suffix in ROBOT_SUFFIXES else None
    extra: dict[str, str] = {}
    replaced: tuple[str, ...] = ()
    if cylinders or ask:
        if robot is None or robot.beside:
            raise ProblemError("cylinders replace drives of a robot file without a sidecar only", where=machine,
                               remedy="state them in the machine file or the sidecar")
        described, extra, replaced = _on_cylinders(robot, machine, cylinders, target)
    elif os.path.isdir(machine):
        described = read(machine, parameter_set=run.parameter_set)[0]
    else:
        described = load_machine(machine, parameter_set=run.parameter_set, tip=tip)
    written = robot_files(run.trusted(described), target)
    write_files(target.parent, written.files | extra)
    if not run.quiet:
        echo(", ".join(str(target.parent / name) for name in (*written.files, *extra)))
        for lost in (*robot.lost, *replaced) if robot else ():
            echo(f"not in {Path(machine).name}'s machine: {lost}")
        for lost in written.lost:
            echo(f"not in {target.name}: {lost}")
        if robot and not robot.beside:
            print_table(FRAMES, robot.frames)


def _on_cylinders(robot: RobotFile, machine: str, file: Path | None,
                  target: Path) -> tuple[Machine, dict[str, str], tuple[str, ...]]:
    """The machine on the cylinders of a file and of those asked for, the latter as a file to be written, and what is
    lost of the drives that they replace."""
    from hydroopt.machine.file_tables import dump_tables
    from hydroopt.machine.robot_formats.cylinder_drives import with_cylinders
    from hydroopt.support.input_file import read_text, toml

    if file is not None:
        stated = toml(read_text(file, MachineError, noun="file of cylinders"), MachineError, where=str(file))
        described, reaches, lost = with_cylinders(robot, stated, str(file))
        for name, reach in reaches.items():
            echo(f"{name}: {reach.shortest:.4g} to {reach.longest:.4g} m long, lever arm at least {reach.arm:.3g}")
        return described, {}, lost
    stated = {}
    for drive in robot.tables.get("drives", []):
        if typer.confirm(f"{drive['joint']}: does a cylinder drive it?", default=True):
            stated |= _asked(robot, drive["joint"], stated)
    name = target.with_suffix(".cylinders.toml").name
    made = with_cylinders(robot, stated, name)
    return made.machine, {name: dump_tables(stated)}, made.lost


def _asked(robot: RobotFile, joint: str, known: dict[str, Any]) -> dict[str, Any]:
    """The table of one cylinder, asked for until it closes over the joint's whole range."""
    from hydroopt.errors import HydrooptError
    from hydroopt.machine.robot_formats.cylinder_drives import with_cylinders

    name = f"{joint}_cylinder"
    while True:
        table: dict[str, Any] = {"joint": joint}
        for end in ("barrel", "rod"):
            link = typer.prompt(f"  link that carries the {end} ({', '.join(list(robot.links)[:12])})")
            pin = typer.prompt(f"  its pin there, x y z [m] in the frame of '{link}'")
            table[end] = {"link": link, "pin": [f"{word} m" for word in pin.replace(",", " ").split()]}
        table |= {key: typer.prompt(f"  {text}") for key, text in _ASKED}
        try:
            reach = with_cylinders(robot, known | {name: table}, "answers").reaches[name]
        except HydrooptError as error:
            echo(f"  {error}")
            continue
        echo(f"  {reach.shortest:.4g} to {reach.longest:.4g} m long, lever arm at least {reach.arm:.3g}")
        return {name: table}
