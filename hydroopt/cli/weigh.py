"""`hydroopt weigh`: the loads that a machine carries while it moves."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydroopt.cli.options import GainError, SinglePrecision, Sizes
from hydroopt.cli.run import ANSWER, LOGS, Run, command

if TYPE_CHECKING:
    from hydroopt.model.model import Model


@command(*ANSWER, *LOGS)
def weigh(
    run: Run,
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help=(
        "Logs of joint angles and pressures, each of which begins with the empty machine in motion."))],
    calibration: Annotated[list[Path], typer.Option(metavar="LOG|DIR", help=(
        "Directory that identify wrote from logs without load; or such a log, repeatable."))],
    full_scale: Annotated[str, typer.Option(help="Largest load, e.g. '2500 kg'.")],
    link: Annotated[str | None, typer.Option(help="Link that carries the load; by default the last one.")] = None,
    centre: Annotated[str | None, typer.Option(help=(
        "Where its centre of mass is expected in the frame of the link, 'x, y, z' in m; by default the link's end."
        ))] = None,
    centre_sigma: Annotated[str, typer.Option(help="Standard deviation of that place.")] = "5 cm",
    tare: Annotated[str, typer.Option(help=(
        "How long the machine is empty at the beginning of each log; '0 s' weighs without a tare."))] = "10 s",
    roll: Annotated[str | None, typer.Option(help="Roll of the base as measured, e.g. '2 deg'.")] = None,
    pitch: Annotated[str | None, typer.Option(help="Pitch of the base as measured.")] = None,
    slope_sigma: Annotated[str, typer.Option(help=(
        "Standard deviation of roll and pitch; the tare determines them where they are not measured."))] = "3 deg",
    zero_drift: Annotated[str, typer.Option(help=(
        "Standard deviation of each pressure's zero since the calibration."))] = "0.35 bar",
    load_friction: Annotated[float, typer.Option(help=(
        "Standard deviation of the friction that grows with the force, as a part of it."))] = 0.01,
    gain_error: GainError = None,
    known: Annotated[list[str] | None, typer.Option(metavar="MASS:LOG", help=(
        "Log with a load of known mass, e.g. '1200 kg:weight.csv', which calibrates the scale; repeatable."))] = None,
    known_sigma: Annotated[str, typer.Option(help="Standard deviation of known masses.")] = "2 kg",
    needed: Annotated[str | None, typer.Option(help=(
        "Half of the 95 % interval above which a mass is too uncertain; 2 % of the full scale if not given."))] = None,
    code: Annotated[bool, typer.Option("--code", help=(
        "Also write the scale as C to DIR/c, for a controller that samples as the log does."))] = False,
    float32: SinglePrecision = False,
    sizes: Sizes = False,
) -> None:
    """Weigh loads while the machine moves: DIR gets weighing.json, report.html and the masses over time.

    Example: hydroopt weigh cat215b work.csv --calibration out/crane --full-scale '2500 kg' -o out/loads
    """
    from hydroopt.codegen.folder import scale_code
    from hydroopt.model.model import Model
    from hydroopt.units import to_si
    from hydroopt.weighing import weighing
    from hydroopt.weighing.calibrated_scale import scale
    from hydroopt.weighing.scale import CarriedLoad, Uncertain

    described = run.machine
    model = Model(described)

    def size(text: str, unit: str, option: str) -> float:
        return to_si(text, unit, where=option)

    carrier = described.links[-1].name if link is None else link
    spread = size(centre_sigma, "m", "--centre-sigma")
    load = CarriedLoad(carrier, _place(model, carrier, centre), (spread, spread, spread),
                       size(full_scale, "kg", "--full-scale"))
    uncertain = Uncertain(size(slope_sigma, "rad", "--slope-sigma"), load_friction,
                          size(zero_drift, "Pa", "--zero-drift"), gain_error)
    tilt = [size(text, "rad", option) if text else stated for text, option, stated in (
        (roll, "--roll", described.orientation[0]), (pitch, "--pitch", described.orientation[1]))]
    with run.progress(f"weighing with {described.name}") as say:
        steps = 3 + len(known or ())
        say("identifying the machine without load", 0.0)
        made = scale(model, run.session(calibration, "--calibration"), load, uncertain=uncertain)
        for k, text in enumerate(known or ()):
            mass, file = _known(text)
            say(f"learning from the known load of {mass}", (1 + k) / steps)
            made = weighing.learned(made, run.read([file])[0], size(mass, "kg", "--known"),
                                    size(known_sigma, "kg", "--known-sigma"))
        made = made.on_slope(*tilt)
        say(f"weighing along {', '.join(each.name for each in logs)}", (steps - 2) / steps)
        found = weighing.weigh(made, run.read(logs), tare=size(tare, "s", "--tare"),
                               needed=None if needed is None else size(needed, "kg", "--needed"))
        written = {} if not code else scale_code(
            found.scale, found.logs[0].equations.smoothed.kernel.step, needed=found.needed, single=float32,
            measured=sizes).files_for(run.output / "c")
        found = run.saved(found, say, {f"c/{name}": text for name, text in written.items()})
    run.show(found)


def _place(model: Model, link: str, text: str | None) -> tuple[float, float, float]:
    """Where a load is expected (3,) [m]: as stated, or at the end of the link.

    Raises:
        ProblemError: the text is not three finite numbers, or there is no such link.
    """
    from hydroopt.errors import ProblemError
    from hydroopt.units import to_si

    if text is None:
        known = [each.name for each in model.machine.links]
        if link not in known:
            raise ProblemError(f"there is no link '{link}'", where="--link", remedy=f"use one of {', '.join(known)}")
        return (model.machine.link(link).joint.a, 0.0, 0.0)
    try:
        x, y, z = (float(part) if _bare(part) else to_si(part, "m", where="--centre") for part in text.split(","))
        if all(math.isfinite(each) for each in (x, y, z)):
            return (x, y, z)
    except ValueError:
        pass
    raise ProblemError(f"'{text}' is no place", where="--centre",
                       remedy="give three lengths, e.g. '1.8 m, 0 m, 0 m'; without a unit they are in m")


def _bare(part: str) -> bool:
    """Whether a number has no unit."""
    return not any(letter.isalpha() for letter in part.replace("e", "").replace("E", ""))


def _known(text: str) -> tuple[str, Path]:
    """Mass and log of a known load.

    Raises:
        ProblemError: the text has another form.
    """
    from hydroopt.errors import ProblemError

    mass, found, file = text.partition(":")
    if not found:
        raise ProblemError(f"'{text}' is not MASS:LOG", where="--known", remedy="write e.g. '1200 kg:weight.csv'")
    return mass, Path(file)
