"""`hydroopt design-calibrator`: the linkage to build for a kinematic calibration, with its poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from hydroopt.cli.options import PosesEach, Priors, Starts
from hydroopt.cli.run import ANSWER, Run, command
from hydroopt.errors import ProblemError

if TYPE_CHECKING:
    from hydroopt.excitation.selection.calibrator_problem import SensorOffer, Workshop
    from hydroopt.machine.machine import Machine

Range = tuple[str, str] | None


@command(*ANSWER, "fix", "reserve", "seed")
def design_calibrator(
    run: Run,
    poses: PosesEach,
    length_std: Annotated[list[str] | None, typer.Option(metavar="[NAME=]LENGTH", help=(
        "Standard deviation to reach of all lengths of the machine's links, such as '2 mm', or of one, such as "
        "'boom.d=6 mm'; repeatable. If not given, the largest is made as small as the most links allow."))] = None,
    links: Annotated[str, typer.Option(metavar="N|FEW:MANY", help="Links of the calibrator.")] = "3:6",
    sensor: Annotated[list[str] | None, typer.Option(metavar="ACCURACY[=COST]", help=(
        "Joint sensor that can be bought, such as '0.1 deg=120'; repeatable. That of the machine's own calibrator if "
        "not given."))] = None,
    link_cost: Annotated[float, typer.Option(help="Cost of a link without its sensor.", min=0.0)] = 1.0,
    keep: Annotated[list[str] | None, typer.Option(help=(
        "Link of the machine file's calibrator that is part of the machine, such as a grapple; repeatable."))] = None,
    longest: Annotated[str | None, typer.Option(metavar="LENGTH", help=(
        "Greatest length of a link; that of the machine file's calibrator if not given."))] = None,
    ball_x: Annotated[Range, typer.Option(metavar="LOW HIGH", help=(
        "Where the ball may stand in the base frame, such as '2 m' '4 m'; within 1 m of the machine file's fixture and "
        "above ground if not given."))] = None,
    ball_y: Annotated[Range, typer.Option(metavar="LOW HIGH", help="The same along y.")] = None,
    ball_z: Annotated[Range, typer.Option(metavar="LOW HIGH", help="The same along z.")] = None,
    length_error: Annotated[str, typer.Option(metavar="LENGTH", help=(
        "Standard deviation to which lengths of the calibrator are known as built."))] = "0 mm",
    angle_error: Annotated[str, typer.Option(metavar="ANGLE", help=(
        "The same of its twists and of the zeros of its sensors."))] = "0 deg",
    priors: Priors = True,
    starts: Starts = 3,
    effort: Annotated[float, typer.Option(min=0.01, help=(
        "Part of the usual number of random calibrators and steps; more searches longer."))] = 1.0,
) -> None:
    """Design the calibrator of fewest or cheapest parts for a stated accuracy of all lengths: DIR gets calibrator.svg,
    parts.csv, the machine that carries it, and the poses to measure.

    Example: hydroopt design-calibrator cat215b -n 40 --length-std '3 mm' --keep grapple_swing --keep grapple -o out/rig
    """
    from hydroopt.excitation.selection.calibrator_design import design_calibrator as design
    from hydroopt.excitation.selection.calibrator_problem import calibrator_problem
    from hydroopt.excitation.selection.pose_problem import pose_problem
    from hydroopt.report.calibrator import drawing

    described = run.machine
    problem = calibrator_problem(
        described, poses, length_std=_lengths(length_std or ()), links=_links(links),
        sensors=[_offer(text) for text in sensor or ()], link_cost=link_cost, keep=keep or (),
        workshop=_workshop(described, longest, (ball_x, ball_y, ball_z), length_error, angle_error),
        priors=priors, reserves=run.reserves,
        fixed=run.fixed(pose_problem(described, 1).parameters) if run.fix else {})
    with run.progress(f"designing a calibrator for {described.name}") as say:
        found = design(problem, starts=starts, effort=effort, seed=run.seed, progress=say)
        found = run.saved(found, say, {"calibrator.svg": str(drawing(found))})
    run.show(found, found.sheet())


def _lengths(stated: Sequence[str]) -> float | dict[str, float] | None:
    """Standard deviations [m] asked for: one of all lengths, or by name."""
    from hydroopt.units import to_si

    named = {name.strip(): to_si(value.strip(), "m", where="--length-std")
             for name, found, value in (text.rpartition("=") for text in stated) if found}
    of_all = [to_si(text, "m", where="--length-std") for text in stated if "=" not in text]
    if len(of_all) > 1 or (of_all and named):
        raise ProblemError("one accuracy of all lengths cannot stand beside another", where="--length-std",
                           remedy="give one length, or NAME=LENGTH for each")
    return of_all[0] if of_all else named or None


def _links(text: str) -> tuple[int, int]:
    few, found, many = text.partition(":")
    try:
        return int(few), int(many if found else few)
    except ValueError:
        raise ProblemError(f"'{text}' is not a number of links", where="--links",
                           remedy="write, for instance, --links 4 or --links 3:6") from None


def _offer(text: str) -> SensorOffer:
    from hydroopt.excitation.selection.calibrator_problem import SensorOffer
    from hydroopt.units import to_si

    accuracy, found, cost = text.partition("=")
    try:
        spent = float(cost) if found else 1.0
    except ValueError:
        raise ProblemError(f"'{cost}' is not a cost", where="--sensor",
                           remedy="write, for instance, --sensor '0.1 deg=120'") from None
    return SensorOffer(to_si(accuracy.strip(), "rad", where="--sensor"), spent)


def _workshop(machine: Machine, longest: str | None, ball: Sequence[Range], length_error: str,
              angle_error: str) -> Workshop:
    """What can be built: as usual for the machine, but for what the options say."""
    from dataclasses import replace

    from hydroopt.excitation.selection.calibrator_problem import usual_workshop
    from hydroopt.units import to_si

    usual = usual_workshop(machine)
    options = ("--ball-x", "--ball-y", "--ball-z")
    ends = [tuple(to_si(text, "m", where=option) for text in stated or ()) or each
            for option, stated, each in zip(options, ball, zip(*usual.site, strict=True), strict=True)]
    (x0, x1), (y0, y1), (z0, z1) = ends
    return replace(
        usual,
        site=((x0, y0, z0), (x1, y1, z1)), length_error=to_si(length_error, "m", where="--length-error"),
        angle_error=to_si(angle_error, "rad", where="--angle-error"),
        longest=usual.longest if longest is None else to_si(longest, "m", where="--longest"))
