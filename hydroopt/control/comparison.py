"""Comparison of controllers on one motion: all candidates on the same machine, with the same sensor errors.

With what each achieves, how robust its loops are, and what uncertain valves and oil may take from that.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hydroopt.control.axes import Axes
from hydroopt.control.cascade import Cascade, Gains
from hydroopt.control.closed_loop import Run
from hydroopt.control.linear_plant import Point, point
from hydroopt.control.loops import Loops, Margin, frequencies
from hydroopt.control.lqg import Lqg, design, reading_noise
from hydroopt.control.reference import refuse_flow, refuse_opening
from hydroopt.control.setting import COMPLETE, TRUE, ModelVariant, Setting
from hydroopt.control.tuning import tuned
from hydroopt.errors import ProblemError
from hydroopt.logs.table import encoded_columns
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.machine import Machine
from hydroopt.model.plant import Plant
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic, Meaning, of_kind
from hydroopt.results.fit import Fit
from hydroopt.results.json_file import Job
from hydroopt.results.machine_diagnostics import machine_diagnostics
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.tables import csv_text, number
from hydroopt.results.verdict import NORMAL, Action, Claim, NextStep, Purpose, Usable
from hydroopt.spatial.inertia import Array
from hydroopt.support.progress import Progress, silent

METHOD = "simulation of closed loops"
PI, FEEDFORWARD, LQG = "pi", "feedforward", "lqg"
SMALL_MARGINS, UNSTABLE = "small margins", "loop unstable in a posture"
"""Kinds of diagnostics by which a controller's use is decided."""
SMALL_DB, SMALL_DEG, SMALL_DISK = 6.0, 30.0, 0.5
"""Gain margin [dB], phase margin [deg] and disk margin below which a loop is reported. A peak sensitivity of 2 leaves
6 dB and 2·asin(1/4) = 29 degrees, rounded up to 30; gains are tuned to more, on the machine as it is known, so that the
true one may differ. Within a disk margin of 0.5 the gain may change by a factor of 1.67, or the phase by 28 degrees, or
both at once by less."""
LITTLE_DAMPING = 0.02
"""Damping ratio below which an oscillation of a closed loop is reported."""
SATURATED = 0.01
"""Part of the time for which a valve may be fully open."""
ROBUST = 1.3
"""A sensitivity that keeps a gain margin of 12.7 dB, offered where those of the usual one turn out small."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one controller achieved on the motion.

    Attributes:
        name: such as ``feedforward complete``.
        kind: `PI`, `FEEDFORWARD` or `LQG`.
        variant: the model and parameters that it uses.
        run: what the machine did.
        error: of the joints (N, n) [rad or m].
        tip: distance (N,) [m] of the last link's far end from where it should be.
        margins: of all loops at all points.
        loops: at the point with the smallest Nyquist distance.
    """

    name: str
    kind: str
    variant: ModelVariant
    run: Run
    error: Array
    tip: Array
    margins: tuple[Margin, ...]
    loops: Loops

    @property
    def in_cascade(self) -> bool:
        """Whether its loops are those of the cascade, which are the same whatever is fed forward."""
        return self.kind != LQG

    @property
    def uses_model(self) -> bool:
        """Whether it knows which forces the motion takes; without them it lags behind."""
        return self.kind != PI

    @property
    def tip_rms(self) -> float:
        """Root mean square [m] of the distance of the tip; infinite if the machine hit its stops."""
        return float(np.sqrt(np.mean(self.tip**2))) if not self.run.stopped else np.inf

    def worst(self, loop: str, key: str, points: Sequence[str] = ()) -> Margin:
        """The smallest margin of a loop by `key`, such as ``gain``, ``disk`` or ``damping``, at some points or all."""
        candidates = [margin for margin in self.margins
                      if margin.loop == loop and (not points or margin.point in points)]
        return min(candidates, key=lambda margin: float(getattr(margin, key)))


class LostMargin(NamedTuple):
    """What a number of valves or oil takes from the disk margin of a loop where it is off by one standard deviation.

    Attributes:
        loop: the actuator at whose command it is cut.
        parameter: the number.
        std: its standard deviation by the machine file.
        unit: of the standard deviation.
        disk: the loop's disk margin, see `Margin`.
        lost: by the worse of both signs; 0 if neither takes any.
    """

    loop: str
    parameter: str
    std: float
    unit: str
    disk: float
    lost: float


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Answer):
    """The outcomes of all candidates on one motion.

    Attributes:
        setting: machine, motion and truth.
        gains: of the cascade.
        points: of the motion, then of the workspace, at which margins were computed.
        outcomes: in the order of the candidates.
        reference: joint positions (N, n) to follow.
        source: origin of the machine's parameters, in words.
        options: of the command, kept in the JSON file.
    """

    job = Job.CONTROL

    setting: Setting
    gains: Gains
    points: tuple[Point, ...]
    outcomes: tuple[Outcome, ...]
    reference: Array
    source: str = "the machine file"
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def machine(self) -> Machine:
        """The machine."""
        return self.setting.plant.machine

    @property
    def method(self) -> str:
        """How it was computed."""
        return METHOD

    @property
    def kinds_of_loops(self) -> list[Outcome]:
        """One outcome for each kind of loops: those of the cascade are the same whatever it is fed forward."""
        cascade = self.feedforward or self.outcomes[0]
        return [outcome for outcome in self.outcomes if outcome is cascade or not outcome.in_cascade]

    @cached_property
    def loop_responses(self) -> tuple[Array, list[Array]]:
        """Frequencies (ω,) [rad/s], and of each of `kinds_of_loops` L(jω) (a, ω) there."""
        loops = [outcome.loops for outcome in self.kinds_of_loops]
        omega = frequencies([system for each in loops for system in (each.plant, each.closed)])
        return omega, [each.responses(omega) for each in loops]

    @cached_property
    def lost_margins(self) -> tuple[LostMargin, ...]:
        """What each uncertain number of valves and oil takes from the best controller's margins, where these are least,
        as far as the controller knows the machine."""
        setting, best = self.setting, self.winner
        at = next(each for each in self.points if each.name == best.loops.point)
        return lost_margins(setting.plant, at, best.loops, self.psi_of(best.variant), setting.theta)

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Small margins, little damping, ended runs and saturated valves."""
        stopped = [] if not self.winner.run.stopped else [Diagnostic.of(
            "even the best run ended early", (self.winner.name,), {},
            "Even the best controller, {subject}, ends before the motion does.",
            "Drive a slower motion, or correct the machine's valves and pump.", Meaning.CONTRADICTION)]
        return (*stopped, *machine_diagnostics(self.setting.plant.model), *self._margins(), *self._runs(),
                *margin_diagnostics(self.winner, self.lost_margins))

    def _margins(self) -> Iterator[Diagnostic]:
        """Loops with small margins, or that are unstable in a posture."""
        for outcome in self.outcomes:
            for each in self.setting.plant.actuators:
                gain, phase, disk, growing = (
                    outcome.worst(each.actuator.name, key) for key in ("gain", "phase", "disk", "damping"))
                if outcome.kind == FEEDFORWARD and outcome is not self.feedforward:
                    continue  # all feedforwards have the same loops
                if growing.damping < 0:
                    yield Diagnostic.of(UNSTABLE, (outcome.name,), {
                        "point": growing.point, "hertz": growing.damping_at / (2 * np.pi),
                        "growth": float(np.expm1(growing.growth))},
                        "With {subject} errors at {hertz:.2g} Hz grow by {growth:.0%} a second in the posture of "
                        "{point}, which the motion passes too fast to be disturbed, or does not reach.",
                        "Do not stay there with this controller; a load that hangs almost undamped needs a brake.")
                    break
                decibels, degrees = 20 * np.log10(gain.gain), np.degrees(phase.phase)
                if decibels < SMALL_DB or degrees < SMALL_DEG or disk.disk < SMALL_DISK:
                    yield Diagnostic.of(SMALL_MARGINS, (outcome.name,), {
                        "loop": each.actuator.name, "gain_db": float(decibels), "gain_point": gain.point,
                        "phase_deg": float(degrees), "phase_point": phase.point, "disk": disk.disk,
                        "disk_point": disk.point},
                        "{subject} leaves the loop of {loop} margins of only {gain_db:.1f} dB ({gain_point}), "
                        "{phase_deg:.0f} degrees ({phase_point}), and a disk margin of {disk:.2f} ({disk_point}).")

    def _runs(self) -> Iterator[Diagnostic]:
        """Runs that ended early, and valves that saturate."""
        low, high = self.setting.demands.valves.limits
        for outcome in self.outcomes:
            if outcome.run.stopped:
                yield Diagnostic.of("run ended early", (outcome.name,), {"reason": outcome.run.stopped}, (
                    "With {subject} {reason}."))
            part = np.mean((outcome.run.u <= low) | (outcome.run.u >= high), axis=0)
            for k, each in enumerate(self.setting.plant.actuators):
                if part[k] > SATURATED:
                    yield Diagnostic.of("valve saturated", (outcome.name,), {
                        "valve": each.actuator.name, "part": float(part[k])},
                        "With {subject} the valve of {valve} is fully open {part:.0f %} of the time.")

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """Whether the best controller follows the motion with sound margins."""
        best = self.winner
        weak = [each for each in of_kind(self.diagnostics, SMALL_MARGINS, UNSTABLE)
                if best.name in each.subject]
        condition = f"RMS of the tip on this motion, simulated; truth: {self.setting.true.text}"
        reason = best.run.stopped or (weak[0].text.rstrip(".") if weak else "")
        figure = None if best.run.stopped else best.tip_rms
        return (Claim(Purpose.CONTROL, best.name, Usable.NO if reason else Usable.YES, figure, "m",
                    condition=condition, reason=reason),)

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What to do with the best controller, or for one that can be used."""
        best = self.winner
        if self.claims[0].usable is Usable.YES:
            return () if self.feedforward is None else (NextStep(
                Action.USE, "Build and test the feedforward in C, and begin at a tenth of the speed:",
                f"make -C {self.command_line.path('c')} check"),)
        machine = self.setting.plant.machine.source
        small = any(best.name in each.subject for each in of_kind(self.diagnostics, SMALL_MARGINS))
        steps = []
        if small and any(each.lost > 0 for each in self.lost_margins):
            steps.append(NextStep(Action.DRIVE, "Identify valves and oil, since margins depend on them:",
                                  f"hydroopt plan-valve-test {machine} -o valve_test"))
        if small and self.setting.sensitivity > ROBUST:
            steps.append(NextStep(Action.CHECK, f"Loops are slower and more robust with --sensitivity {ROBUST:g}.",
                                  self.command_line.again("--sensitivity", f"{ROBUST:g}")))
        return tuple(steps) or (NextStep(Action.DRIVE, "Give a slower motion, for instance that of:",
                                         f"hydroopt excite {machine} --speed '50 %' -o motion"),)

    @cached_property
    def parameters(self) -> ParameterTable:
        """The tuned gains of the cascade."""
        gains, axes, rows = self.gains, Axes(self.setting.plant), []
        for i, name in enumerate(axes.names):
            forces = []
            for k in axes.actuators[i]:
                actuator = axes.plant.actuators[k].actuator
                speed, force = ("m/s", "N") if isinstance(actuator, Cylinder) else ("rad/s", "N*m")
                forces.append((f"{actuator.name}.force_gain", f"{speed}/({force})", gains.force[k]))
            for address, unit, value in ((f"{name}.position_gain", "1/s", gains.position[i]), *forces,
                                         (f"{name}.integral_time", "s", gains.integral_time[i]),
                                         (f"{name}.filter_time", "s", gains.filter_time[i])):
                rows.append(row(address, "gain", unit, value=float(value)))
        return ParameterTable(rows)

    @cached_property
    def fit(self) -> Mapping[str, Mapping[str, Fit]]:
        """Tracking errors by controller and joint."""
        return {outcome.name: {f"{joint}.q": self._tracking(outcome, k) for k, joint in enumerate(self.machine.joints)}
                for outcome in self.outcomes}

    def _tracking(self, outcome: Outcome, k: int) -> Fit:
        error, reference = outcome.error[:, k], self.reference[:len(outcome.error), k]
        return Fit.of(error, reference, self.machine.channel_units[f"{self.machine.joints[k]}.q"], free_run=True)

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """Empty: everything is simulated."""
        return ()

    def details(self) -> Mapping[str, Any]:
        """Options, the best candidate, and errors, pressures, energy and smallest margins of every candidate."""
        return {**self.options, "origin": self.source, "rate": self.setting.rate,
                "truth_text": self.setting.true.text, "winner": self.winner.name,
                "candidates": [self._candidate(each) for each in self.outcomes],
                "lost_margins": [each._asdict() for each in self.lost_margins]}

    def _candidate(self, outcome: Outcome) -> dict[str, Any]:
        run = outcome.run
        return {"name": outcome.name, "kind": outcome.kind, "parameters": outcome.variant.name,
                "from": outcome.variant.text, "stopped": run.stopped or None,
                "tip": {"rms": number(outcome.tip_rms), "max": number(np.max(outcome.tip)), "unit": "m"},
                "joints": self._joints(outcome), "peak_pressure": float(np.max(run.pressure)),
                "lowest_supply": float(np.min(run.p_supply)), "energy": run.energy,
                "loops": [{"actuator": each.actuator.name} | {
                    f"least_{key}_margin": outcome.worst(each.actuator.name, key).as_dict()
                    for key in ("gain", "phase", "disk", "damping")} for each in self.setting.plant.actuators]}

    def _joints(self, outcome: Outcome) -> list[dict[str, Any]]:
        """Error of every joint; of a passive one, which no actuator moves, how far it swings from where it should."""
        plant, rows = self.setting.plant, []
        for k, joint in enumerate(self.machine.joints):
            places = list(plant.drivers.get(joint, ()))
            rows.append({
                "joint": joint, "unit": self.machine.channel_units[f"{joint}.q"],
                "rms": float(np.sqrt(np.mean(outcome.error[:, k] ** 2))),
                "max": float(np.max(np.abs(outcome.error[:, k]))),
                "actuator": " and ".join(plant.actuators[i].actuator.name for i in places) or None,
                "peak_pressure": float(np.max(outcome.run.pressure[:, places])) if places else None})
        return rows

    def files(self) -> Mapping[str, str | bytes]:
        """Tables of tracking errors and of margins; reference, positions and commands of all runs that reached the
        end."""
        tracking = [{"controller": outcome.name, "parameters": outcome.variant.name, **each}
                    for outcome in self.outcomes for each in self._joints(outcome)]
        margins = [{"controller": outcome.name, **margin.as_dict()}
                   for outcome in self.outcomes for margin in outcome.margins]
        columns = {"t [s]": self.setting.t}
        units = [self.machine.channel_units[f"{joint}.q"] for joint in self.machine.joints]
        for k, joint in enumerate(self.machine.joints):
            columns[f"{joint}.q [{units[k]}]"] = self.reference[:, k]
        for outcome in self.outcomes:
            if outcome.run.stopped:
                continue
            start = outcome.name.replace(" ", "_")
            for k, joint in enumerate(self.machine.joints):
                columns[f"{start}.{joint}.q [{units[k]}]"] = outcome.run.q[:, k]
            for k, name in enumerate(self.setting.plant.inputs):
                unit = self.setting.plant.actuators[k].valve.command
                columns[f"{start}.{name} [{unit}]"] = outcome.run.u[:, k]
        return {"tracking.csv": csv_text(tracking), "margins.csv": csv_text(margins),
                "runs.csv": encoded_columns(columns)}

    def __str__(self) -> str:
        lines = [f"{self.machine_name}: {len(self.reference)} samples at {self.setting.rate:g} Hz, "
                 f"truth: {self.setting.true.text}"]
        for outcome in self.outcomes:
            lines.append(f"  {outcome.name}: " + (outcome.run.stopped or (
                f"tip {1e3 * outcome.tip_rms:.1f} mm RMS, {1e3 * outcome.tip.max():.1f} mm at most; "
                f"{outcome.run.pressure.max() / 1e5:.0f} bar at most, {outcome.run.energy / 1e3:.0f} kJ"))
                + (" (best)" if outcome is self.winner else ""))
        return "\n".join(lines)

    def psi_of(self, variant: ModelVariant) -> Array:
        """Parameters ψ (p,) of the complete model with the forces of a variant: zero for bodies that it lacks."""
        positions = variant.model.parameters.positions
        return np.array([variant.psi[positions[name]] if name in positions else 0.0
                         for name in self.setting.plant.model.parameters.names])

    @property
    def winner(self) -> Outcome:
        """The outcome with the smallest RMS error of the tip, among those that do not use the true parameters."""
        return min((o for o in self.outcomes if o.variant.name != TRUE), key=lambda o: o.tip_rms)

    @property
    def feedforward(self) -> Outcome | None:
        """The best feedforward that does not use the true parameters."""
        candidates = [o for o in self.outcomes if o.kind == FEEDFORWARD and o.variant.name != TRUE]
        return min(candidates, key=lambda o: o.tip_rms, default=None)


def compare(setting: Setting, variants: Sequence[ModelVariant], kinds: Sequence[str] = (PI, FEEDFORWARD, LQG), *,
            progress: Progress = silent) -> Comparison:
    """Let every candidate follow the motion.

    Gains are tuned once, by the parameters that count as complete, and are the same for PI and all feedforwards.

    Args:
        setting: machine, motion and truth.
        variants: models to give to controllers, the complete one among them; the true one is added.
        kinds: of controllers.
        progress: receives the steps, see `hydroopt.support.progress`.

    Raises:
        ProblemError: the motion demands more than pump or valves give, the base moves in it, or a loop
            is unstable at a point of the motion.
        SolverError: the plant could not be integrated.
    """
    best = next(each for each in variants if each.name == COMPLETE)
    demands, period = setting.demands, 1 / setting.rate
    refuse_flow(setting.plant, setting.reference.at(setting.t))
    demand = demands.by(best.model, best.psi)
    refuse_opening(setting.plant, setting.t, demand, demands.valves)
    wanted = 2 * (PI in kinds) + (FEEDFORWARD in kinds) * (len(variants) + 1) + (LQG in kinds)

    def stage(first: int, name: str = "") -> Progress:
        """Of a step among all: tuning, then each candidate."""
        return lambda text, part=None: progress(name or text, (first + (part or 0.0)) / (1 + wanted))

    stage(0)("linearising")
    points = setting.points(setting.plant, best.psi, setting.theta)
    gains = tuned(points, demands.valves, setting.sensitivity, stage(0))
    gains = replace(gains, position=setting.gain * gains.position)
    candidates: list[tuple[str, str, ModelVariant, Cascade | Lqg]] = []
    if PI in kinds:
        for name, still in (("PI with gravity compensation", True), ("PI with gravity and speeds", False)):
            static = demands.by(best.model, best.psi, static_forces=True, still=still)
            candidates.append((name, PI, best, Cascade(demands.valves, static, gains, period)))
    if FEEDFORWARD in kinds:
        candidates += [(f"feedforward {each.name}", FEEDFORWARD, each, Cascade(
            demands.valves, demands.by(each.model, each.psi), gains, period)) for each in (*variants, setting.true)]
    if LQG in kinds:
        noise = reading_noise(setting.plant)
        designs = [design(each, demands.valves, gains.position, noise) for each in points if each.on_motion]
        candidates.append(("LQG", LQG, best, Lqg(demands.valves, demand, designs, period)))
    points = setting.points(setting.true_plant, setting.true.psi, setting.true_theta)
    axes, path, outcomes = Axes(setting.plant), setting.reference.at(setting.t), []
    analysed: dict[type, list[Loops]] = {}  # all cascades have the same loops
    for k, (name, kind, variant, controller) in enumerate(candidates):
        at = stage(1 + k, name)
        at(name)
        if type(controller) not in analysed:
            analysed[type(controller)] = [Loops.about(each, axes, controller.linear(each)) for each in points]
        loops = analysed[type(controller)]
        refuse_unstable(name, [margin for one, each in zip(loops, points, strict=True) if each.on_motion
                               for margin in one.margins], setting.motion.t[-1] - setting.motion.t[0])
        run = setting.run(controller, at)
        nearest = min(loops, key=lambda one: min(margin.distance for margin in one.margins))
        outcomes.append(Outcome(name, kind, variant, run, run.q - path.q[:len(run.t)], setting.tip_error(run),
                                tuple(margin for one in loops for margin in one.margins), nearest))
    return Comparison(setting, gains, tuple(points), tuple(outcomes), path.q)


def refuse_unstable(name: str, margins: Sequence[Margin], duration: float) -> None:
    """Refuse a controller whose errors grow to more than e times within the motion's duration [s], if its loops were
    all the time as at one of its points.

    Slower growth passes: a point lasts for a part of the motion only, and a load that hangs almost undamped may swing a
    little more in a posture, whatever the controller. `UNSTABLE_IN_POSTURE` reports it.

    Raises:
        ProblemError: errors grow faster; the sentence states loop, posture and gain margin.
    """
    unstable = [margin for margin in margins if margin.growth * duration > 1]
    if unstable:
        worst = min(unstable, key=lambda margin: margin.distance)
        raise ProblemError(
            f"the loop of '{worst.loop}' is unstable with {name} in the posture of the {worst.point}, where its gain "
            f"margin is {20 * np.log10(worst.gain):.1f} dB", where="closed loop",
            remedy="lower --gain or --sensitivity, raise --rate, or leave this controller out with --controller")


def margin_diagnostics(best: Outcome, lost: Sequence[LostMargin]) -> Iterator[Diagnostic]:
    """Oscillations of the best controller's loops that hardly decay, and margins that uncertain valves may take."""
    least = min(best.margins, key=lambda margin: margin.damping)
    if 0 <= least.damping < LITTLE_DAMPING:
        yield Diagnostic.of("little damping", (best.name,), {
            "damping": least.damping, "hertz": least.damping_at / (2 * np.pi), "point": least.point,
            "undisturbed": least.undisturbed},
            "With {subject} an oscillation at {hertz:.1f} Hz is damped by a ratio of only {damping:.3f} ({point}); "
            "without feedback the least is {undisturbed:.3f}.",
            "Leaks, friction and measured pressures damp oil: see the table of loops.", Meaning.PROPERTY)
    for loop in dict.fromkeys(each.loop for each in lost):
        own = [each for each in lost if each.loop == loop]
        low = own[0].disk - NORMAL * float(np.linalg.norm([each.lost for each in own]))
        if low < SMALL_DISK <= own[0].disk:
            yield Diagnostic.of("margins depend on uncertain valves", (best.name,), {
                "loop": loop, "disk": own[0].disk, "low": max(low, 0.0), "point": best.loops.point,
                "parameter": max(own, key=lambda each: each.lost).parameter},
                "Numbers of valves and oil are so uncertain that the disk margin of {loop} with {subject} may be "
                "{low:.2f} instead of {disk:.2f} ({point}), most of all by {parameter}.",
                "Identify them: `hydroopt plan-valve-test`.", Meaning.PROPERTY)


def lost_margins(plant: Plant, at: Point, loops: Loops, psi: Array, theta: Array) -> tuple[LostMargin, ...]:
    """Of every loop at a point, by every number that the machine file states a confidence of.

    The controller stays as it is, the machine changes. Numbers with which it could not move at the point are left out.

    Args:
        plant: the machine as it is known.
        at: the operating point.
        loops: at this point.
        psi: dynamic parameters (p,) that are known.
        theta: hydraulic ones.
    """
    known = plant.parameters
    found: list[LostMargin] = []

    def disks(numbers: Array) -> Array:
        """Disk margins (a,) of the loops of a machine with other numbers."""
        there = point(plant, at.name, at.q, at.qd, psi, numbers, loops.plant.dt)
        return replace(loops, plant=there.system).disks

    try:
        nominal = disks(theta)
    except ProblemError:  # the machine can move here, but not as it is known
        return ()
    for k in np.flatnonzero(np.diag(known.information) > 0):
        std, least = float(known.scale[k]), nominal
        for side in (-std, std):
            moved = theta.copy()
            moved[k] = np.clip(theta[k] + side, known.lower[k], known.upper[k])
            try:
                least = np.minimum(least, disks(moved))
            except ProblemError:
                continue
        found += [LostMargin(name, known.names[k], std, known.units[k], float(disk), float(disk - low))
                  for name, disk, low in zip(loops.names, nominal, least, strict=True)]
    return tuple(found)
