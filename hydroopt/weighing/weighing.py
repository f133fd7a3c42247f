"""The loads that a machine carried in a log, weighed while it moved."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.errors import LogError, ProblemError
from hydroopt.estimation.dynamic.claims import TO_SCALE, scale_assumed
from hydroopt.logs.frames import all_of
from hydroopt.logs.log import Log
from hydroopt.machine.machine import Machine
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.results.json_file import Job
from hydroopt.results.parameter_table import ParameterRow, ParameterTable, row
from hydroopt.results.readable import readable
from hydroopt.results.tables import csv_text, number
from hydroopt.results.verdict import NORMAL, Action, Claim, NextStep, Purpose, Usable, judged
from hydroopt.spatial.inertia import Array
from hydroopt.weighing.course import CONTRADICTED, Reading, Weighable, course
from hydroopt.weighing.equations import Equations, equations
from hydroopt.weighing.recursion import Recursion, Weighed
from hydroopt.weighing.scale import Scale, corrected, in_another_session, with_gains
from hydroopt.weighing.smoothed_log import smoothed_log

METHOD = "moving scale"
PASSES = 4
"""How often a log with a known load is linearised."""
WRONG_GAIN, WRONG_STD = 0.02, 3.0
"""Relative error of a force reading, and how many of its standard deviations, from which it is worth correcting."""
IMPLAUSIBLE = 3.0
"""Number of stated standard deviations from which an error of a force reading is not believed."""
NEEDED = 0.02
"""Half of a mass's 95 % interval, as a part of the full scale, above which it is too uncertain by default."""


@dataclass(frozen=True, eq=False)
class WeighedLog:
    """What a scale showed over a log.

    Attributes:
        log: that was weighed.
        equations: of its smoothed samples.
        readings: what the scale showed at each of them.
        first: number of loads in the logs before.
    """

    log: Log
    equations: Equations
    readings: tuple[Reading, ...]
    first: int

    @property
    def t(self) -> Array:
        """(M,) times of the readings [s]."""
        return self.equations.t

    @cached_property
    def loads(self) -> tuple[LoadWeighed, ...]:
        """The loads one after the other, without the empty machine at the beginning."""
        found: list[LoadWeighed] = []
        for k in range(1, self.readings[-1].load + 1):
            some = [each for each in self.readings if each.load == k]
            good = [each for each in some if each.status is Weighable.OK]
            found.append(LoadWeighed(self.first + k, self.log.name, float(self.t[some[0].sample]),
                                     float(self.t[some[-1].sample]), (good or some)[-1]))
        return tuple(found)


@dataclass(frozen=True)
class LoadWeighed:
    """One load of a log.

    Attributes:
        number: from 1, over all logs.
        log: name of its log.
        begin, end: when it was carried [s].
        reading: the last one that can be believed, or else the last one.
    """

    number: int
    log: str
    begin: float
    end: float
    reading: Reading

    @property
    def name(self) -> str:
        """``load_1`` and so on."""
        return f"load_{self.number}"

    @property
    def ok(self) -> bool:
        """Whether it was weighed."""
        return self.reading.status is Weighable.OK

    @property
    def mass(self) -> float:
        """[kg]."""
        return self.reading.weighed.mass

    @property
    def mass_std(self) -> float:
        """[kg]."""
        return self.reading.weighed.mass_std


@dataclass(frozen=True, eq=False, repr=False)
class Weighing(Answer):
    """What a scale showed over one log or several; `weigh` returns it.

    Attributes:
        scale: that weighed.
        logs: what it showed over each log.
        needed: half of the 95 % interval [kg] above which a mass is too uncertain.

    Example:
        See `weigh`.
    """

    scale: Scale
    logs: tuple[WeighedLog, ...]
    needed: float
    job = Job.WEIGHING

    @property
    def machine(self) -> Machine:
        """The machine that it is about."""
        return self.scale.machine

    @property
    def method(self) -> str:
        """How it was computed."""
        return METHOD

    @cached_property
    def loads(self) -> tuple[LoadWeighed, ...]:
        """The loads one after the other, log by log."""
        return tuple(load for each in self.logs for load in each.loads)

    @cached_property
    def readings(self) -> tuple[Reading, ...]:
        """What the scale showed, log by log."""
        return tuple(reading for each in self.logs for reading in each.readings)

    def centre(self, weighed: Weighed) -> tuple[Array, Array]:
        """Centre of mass (3,) of a load in the frame of its link [m], and standard deviations."""
        phi, covariance = weighed.phi, weighed.covariance
        if not phi[0] > 0:
            return np.full(3, np.nan), np.full(3, np.nan)
        offset = phi[1:4] / phi[0]
        J = np.column_stack([-offset, np.eye(3)]) / phi[0]
        return (np.array(self.scale.load.centre) + offset,
                np.sqrt(np.einsum("ij,jk,ik->i", J, covariance[:4, :4], J)))

    @cached_property
    def table(self) -> Mapping[str, Array]:
        """Columns over time: time [s], number of the load, mass, its standard deviation and 95 % interval [kg], centre
        [m], misfit."""
        masses = np.array([each.weighed.mass for each in self.readings])
        stds = np.array([each.weighed.mass_std for each in self.readings])
        centres = np.array([np.concatenate(self.centre(each.weighed)) for each in self.readings])
        return {"t [s]": np.concatenate([each.t for each in self.logs]),
                "load": np.array([each.first + reading.load if reading.load else 0
                                  for each in self.logs for reading in each.readings]),
                "mass [kg]": masses, "std [kg]": stds, "low [kg]": masses - NORMAL * stds,
                "high [kg]": masses + NORMAL * stds,
                **{f"com_{axis} [m]": centres[:, k] for k, axis in enumerate("xyz")},
                **{f"com_{axis}_std [m]": centres[:, 3 + k] for k, axis in enumerate("xyz")},
                "misfit": np.array([each.weighed.misfit for each in self.readings])}

    @cached_property
    def findings(self) -> tuple[Diagnostic, ...]:
        """Each load in a sentence, or that there is none."""
        if not self.loads:
            return (Diagnostic.of("no load found", (), {
                "begin": float(self.logs[0].t[0]), "end": float(self.logs[-1].t[-1])},
                "No load was found from {begin:.1f} to {end:.1f} s: nothing differs from the tare.",
                "The log must begin with the empty machine, and go on with a load."),)
        return tuple(Diagnostic.of("load weighed", (each.name,), {
            "mass": f"{each.mass:.0f} ± {NORMAL * each.mass_std:.0f}", "begin": each.begin, "end": each.end},
            "{subject} weighs {mass} kg (95 %), carried from {begin:.1f} to {end:.1f} s.")
            if each.ok else Diagnostic.of("load not weighable", (each.name,), {
                "why": str(each.reading.status), "begin": each.begin, "end": each.end},
                "{subject}, carried from {begin:.1f} to {end:.1f} s, cannot be weighed: {why}.",
                "Move several joints for some seconds with it.") for each in self.loads)

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Whether readings contradict the calibrated model, whether anything was weighed, and what is known of the
        readings' scale."""
        return tuple(self._diagnostics())

    def _diagnostics(self) -> Iterator[Diagnostic]:
        worst = max((each.weighed.misfit for each in self.readings if each.status in (
            Weighable.CONTRADICTED, Weighable.TARING)), default=0.0)
        if worst > CONTRADICTED:
            yield Diagnostic.of("readings contradict the scale's model", (), {"misfit": worst}, (
                "Readings contradict the calibrated model: residuals are {misfit:.1f} times as large as expected."),
                "Check where the load's centre of mass is (--centre, --centre-sigma), signs and channels of "
                "pressures, that the machine was empty during the tare, the tool, and the calibration.",
                Meaning.CONTRADICTION)
        elif self.loads and not any(each.ok for each in self.loads):
            yield Diagnostic.of("no load weighed", tuple(each.name for each in self.loads), {
                "why": "; ".join(dict.fromkeys(str(each.reading.status) for each in self.loads))}, (
                "Not one load could be weighed: {subject} ({why})."),
                "Check where the load's centre of mass is (--centre, --centre-sigma), and move several joints for "
                "some seconds with each load.", Meaning.CONTRADICTION)
        if self.scale.exact:
            yield scale_assumed()
        readings = self.scale.readings
        if not self.scale.known_loads or readings is None:
            return
        for balance, part, variance in zip(self.scale.machine.balances, self.scale.read,
                                           np.diag(readings.too_large.covariance), strict=True):
            if abs(part) > max(WRONG_GAIN, WRONG_STD * np.sqrt(variance)):
                yield Diagnostic.of("scale of a force reading wrong", (balance.name,), {
                    "percent": f"{100 * abs(part):.1f} ± {100 * NORMAL * np.sqrt(variance):.1f}",
                    "way": "large" if part > 0 else "small"},
                    "By the known load the force of {subject} is read {percent} % too {way}; the masses are corrected "
                    "for it.",
                    "Correct its piston areas or torque per pressure in the machine file, or its sensors' scale, and "
                    "calibrate again.")

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """How well each load is weighed."""
        full, scaled = self.scale.load.full_scale, f"; {TO_SCALE}" if self.scale.exact else ""
        return tuple(
            judged(Purpose.WEIGHING, each.name, NORMAL * each.mass_std, "kg", NORMAL * each.mass_std / full,
                   condition=f"95 % interval, as a part of the full scale of {readable(full, 'kg')}{scaled}")
            if each.ok else
            Claim(Purpose.WEIGHING, each.name, Usable.NO, reason=str(each.reading.status)) for each in self.loads)

    @property
    def headline(self) -> str:
        """How many loads were weighed."""
        if not self.loads:
            return self.findings[0].text
        scaled, weighed = f", {TO_SCALE}" if self.scale.exact else "", sum(each.ok for each in self.loads)
        return f"{weighed} of {len(self.loads)} loads {'is' if weighed == 1 else 'are'} weighed{scaled}."

    def __str__(self) -> str:
        load = self.scale.load
        place, spread = ", ".join(f"{x:.3g}" for x in load.centre), readable(max(load.centre_std), "m")
        return (f"{super().__str__()}\n  Assumed: the load's centre of mass lies at {place} m in the frame of "
                f"{load.link}, ±{spread}. State it: --centre, --centre-sigma.")

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What would weigh better."""
        if not self.loads:
            return (NextStep(Action.CHECK, "If a load was carried, check that the machine was empty during the tare: "
                                           "--tare states how long it is at the beginning."),)
        known = NextStep(Action.MEASURE, (
            "Weigh one known load, such as 1200 kg in weight.csv: only it shows errors of areas and sensors' scales."),
            self.command_line.again("--known", "1200 kg:weight.csv"))
        if all(each.ok for each in self.loads):
            return () if self.scale.known_loads else (known,)
        if any(NORMAL * self.scale.gain * abs(each.mass) > self.needed for each in self.loads):
            return (known,)
        return (NextStep(Action.DRIVE, "Move several joints for some seconds with each load, or state its centre of "
                                       "mass more closely."),)

    @cached_property
    def parameters(self) -> ParameterTable:
        """Mass and centre of mass of each load."""
        rows: list[ParameterRow] = []
        for each in self.loads:
            known = "full" if each.ok else "not excited"
            rows.append(_row(f"{each.name}.m", ParameterKind.MASS, "kg", each.mass, each.mass_std, known))
            centre, spread = self.centre(each.reading.weighed)
            rows += [_row(f"{each.name}.com_{axis}", ParameterKind.POSITION, "m", value, std, known)
                     for axis, value, std in zip("xyz", centre.tolist(), spread.tolist(), strict=True)]
        return ParameterTable(rows)

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The logs."""
        return tuple({"path": log.path or log.name, "sha256": log.sha256 or None, "samples": log.size,
                      "role": "weighed"} for log in (each.log for each in self.logs))

    def details(self) -> Mapping[str, Any]:
        """The loads with their times and statuses, and what the scale assumes."""
        load, uncertain = self.scale.load, self.scale.uncertain
        return {"loads": [{"name": each.name, "log": each.log, "begin": each.begin, "end": each.end,
                           "status": str(each.reading.status), "misfit": number(each.reading.weighed.misfit)}
                          for each in self.loads],
                "assumed": {"link": load.link, "centre": list(load.centre), "centre_std": list(load.centre_std),
                            "full_scale": load.full_scale, "radius": load.radius, "slope_std": uncertain.slope,
                            "load_friction": uncertain.load_friction, "zero_drift": uncertain.zero_drift,
                            "gain": self.scale.gain, "known_loads": self.scale.known_loads}}

    def files(self) -> Mapping[str, str]:
        """What the scale showed over time, as CSV."""
        columns = {"log": [each.log.name for each in self.logs for _ in each.readings],
                   **{key: values.tolist() for key, values in self.table.items()},
                   "status": [str(each.status) for each in self.readings]}
        return {"weighing.csv": csv_text([dict(zip(columns, values, strict=True))
                                          for values in zip(*columns.values(), strict=True)])}


def _row(name: str, kind: ParameterKind, unit: str, value: float, std: float, known: str) -> ParameterRow:
    if known != "full" or not np.isfinite(value):
        return row(name, kind, unit, identifiability="not excited")
    return row(name, kind, unit, value=value, std=std, ci95=(value - NORMAL * std, value + NORMAL * std),
               identifiability=known)


def weigh(scale: Scale, logs: Log | Sequence[Log], *, tare: float = 10.0, needed: float | None = None) -> Weighing:
    """Weigh the loads of one log or several while the machine moves.

    Each log begins with the empty machine in motion. It tells slope, friction and what has drifted since the
    calibration; each change of the load begins a new one.

    Args:
        scale: of the machine, on the logs' slope.
        logs: joint angles and pressures at a regular rate.
        tare: how long the machine is empty at the beginning of each log [s]; 0 weighs without a tare.
        needed: half of the 95 % interval [kg] above which a mass is too uncertain; 2 % of the full scale by default.

    Raises:
        LogError: there is no log, or one lacks a channel, is too short, or sampled irregularly.
        ProblemError: the tare is negative, or no interval is small enough.

    >>> import hydroopt as ho
    >>> model = ho.Model("patu655_lift")
    >>> motions = [ho.random_trajectory(model, duration=30, rate=50, seed=k) for k in (1, 2)]
    >>> known, empty = (ho.simulate(model, motion, seed=k) for k, motion in enumerate(motions))
    >>> load = ho.CarriedLoad("lift", (3.0, 0.0, 0.0), (0.05, 0.05, 0.05), full_scale=1000.0)
    >>> scale = ho.scale(model, known, load)
    >>> found = ho.weigh(scale.on_slope(*scale.tilt), empty, tare=10.0)
    >>> found.loads, found.centre(found.readings[-1].weighed)[0].shape
    ((), (3,))
    """
    if not (tare >= 0 and (needed is None or needed > 0)):
        raise ProblemError("a tare is not negative, and an interval positive", where="weighing",
                           remedy="give the tare in s and the interval in kg")
    needed = NEEDED * scale.load.full_scale if needed is None else needed
    given = all_of(logs, (Log,), "log", scale.machine.name)
    if not given:
        raise LogError("there is no log", where="weighing", remedy="give one or several")
    found: list[WeighedLog] = []
    for log in given:
        made = equations(scale, smoothed_log(scale.model, log))
        if not np.all(np.isfinite(made.rest)):
            raise LogError("a scale needs the pressures of all actuators", where=log.path or log.name,
                           remedy="record them, or leave out samples that are not numbers with --treat nan=drop")
        with threadpool_limits(limits=1, user_api="blas"):
            shown = tuple(course(made, tare=tare, needed=needed))
        found.append(WeighedLog(log, made, shown, sum(each.readings[-1].load for each in found)))
    return Weighing(scale, tuple(found), needed)


def learned(scale: Scale, log: Log, mass: float, std: float) -> Scale:
    """The scale after a log with a load of known mass [kg], with its standard deviation: its calibration.

    What the log says about bodies, friction and the scale of force readings stays; what it says about its slope and its
    pressures' zeros does not.

    Raises:
        LogError: see `weigh`.
        ProblemError: the standard deviation is not positive, or mass and log contradict the model or each other.

    See `weigh` for an example of the other steps.
    """
    if not (np.isfinite(mass) and np.isfinite(std) and std > 0):
        raise ProblemError("a known load has a finite mass and a positive standard deviation", where="learned",
                           remedy="give both in kg")
    scale = with_gains(scale)
    made = equations(scale, smoothed_log(scale.model, log))
    with threadpool_limits(limits=1, user_api="blas"):
        sought = Recursion(made, scale.own, mass)
        for _ in range(PASSES):
            own, phi = sought.own, sought.phi
            sought = Recursion(made, scale.own, mass)
            for i in range(len(made.t)):
                sought.own, sought.phi = own, phi  # each pass is linearised where the last one ended
                sought.take(i)
            found = sought.solved(known=(mass, std))
    if found.misfit > CONTRADICTED:
        raise ProblemError(f"the log contradicts the scale's model ({found.misfit:.1f} times the expected residuals)",
                           where=log.path or log.name, remedy="check the mass, the load's centre and the slope")
    shown = np.sum(np.where(made.moving, made.K[:, :, -10], 0.0) ** 2, axis=0) / scale.force_std**2
    made_sure = corrected(scale, found.own[:-2], shown / np.sum(shown))
    wrong = float(max(made_sure.read, key=abs))
    if scale.readings is not None and abs(wrong) > IMPLAUSIBLE * scale.readings.std:
        raise ProblemError(f"a force reading would have to be {100 * abs(wrong):.0f} % too "
                           f"{'large' if wrong > 0 else 'small'} for a load of {mass:g} kg",
                           where=log.path or log.name, remedy="correct the known mass, or the areas in the machine "
                           "file; a larger --gain-error (gain) allows for larger errors")
    return in_another_session(made_sure)
