"""`hydroopt codegen`: the model as C for a controller."""

from __future__ import annotations

import shlex
from typing import Annotated

import typer

from hydroopt.cli.options import MachineOrFolder, SinglePrecision, Sizes
from hydroopt.cli.run import Run, command
from hydroopt.cli.terminal import echo


@command("output", "parameter_set", "force", "quiet", machine=MachineOrFolder)
def codegen(
    run: Run,
    functions: Annotated[list[str] | None, typer.Option(
        help="A routine to write, see README.md in DIR; repeatable; all if not given.")] = None,
    prefix: Annotated[str | None, typer.Option(help="Prefix of all names; else the machine's name.")] = None,
    float32: SinglePrecision = False,
    fold_geometry: Annotated[bool, typer.Option("--fold-geometry", help=(
        "Build the geometry into the code: fewer operations, but a calibration needs new code."))] = False,
    sizes: Sizes = False,
    hosts: Annotated[list[str] | None, typer.Option("--for", metavar="HOST", help=(
        "Also write what a host needs that calls the C: cpp, python, ros2_control, simulink, codesys or fmi; "
        "repeatable."))] = None,
) -> None:
    """Write the model as C for a controller: DIR gets a folder that builds and tests itself.

    Example: hydroopt codegen cat215b -o out/c
    """
    from hydroopt.codegen import parameter_source as codegen_origin
    from hydroopt.codegen.folder import Code
    from hydroopt.model.model import Model
    from hydroopt.results.machine_diagnostics import machine_diagnostics

    described, origin = codegen_origin.read(run.named, parameter_set=run.parameter_set)
    run.trusted(described)
    with run.progress(f"writing C for {described.name}") as say:
        code = Code(described, origin, routines=functions or (), name=prefix, single=float32,
                    fold_geometry=fold_geometry, measured=sizes, hosts=hosts or ())
        files = code.write(run.output, say)
    for diagnostic in machine_diagnostics(Model(described)):
        echo(f"! {diagnostic}", err=True)
    if not run.quiet:
        echo(f"{run.output}: {len(files)} files. Build and test them: make -C {shlex.quote(str(run.output))} check")
    for reason, names in code.missing.items():
        echo(f"missing: {', '.join(names)}, since {reason}", err=run.quiet)
    if code.untested:
        echo(f"! {code.untested}", err=True)
