"""How wrong an identified model is: forces that it predicts, single masses, loads that it weighs, control."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.calibrated import calibrated_machine
from hydroopt.estimation.dynamic.folding import split, triangle
from hydroopt.estimation.dynamic.identification import Identification, Intervals
from hydroopt.estimation.inference.identifiability import FULL, NONE, PRESSURES, random_states
from hydroopt.estimation.inference.left_out import LEVEL
from hydroopt.estimation.inference.whitening import gaussian_posterior
from hydroopt.machine.actuators import Actuator, Drive
from hydroopt.machine.balances import UnmeasuredJoint
from hydroopt.machine.machine import Machine
from hydroopt.model.hanging import Hanging
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.model.model import Model
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.results.answer import CommandLine
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.parameter_table import ParameterRow, ParameterTable
from hydroopt.results.readable import percentage, readable
from hydroopt.results.verdict import NORMAL, About, Action, Claim, NextStep, Purpose, Usable, judged
from hydroopt.spatial.inertia import Array

POSTURES, DRAWS = 200, 400
"""Number of states, and of parameters by the intervals, over which errors are computed."""
FROM_DATA = 0.75
"""Least part of the information on a number that is from data: then its σ is at most half of the prior's."""
SLOW = 0.1
"""Speed at which a load is weighed, as a part of the logs' RMS speed."""
WEIGHED = 5.0
"""Seconds over which readings are averaged when a load is weighed."""
GAIN, TILT = 0.01, np.radians(0.5)
"""Standard deviations where the machine file states none: of the scale of force readings with their areas, since
transmitters of mobile machines state 0.5 to 1 % of full scale, and of the tilt [rad] of a base levelled by a vial."""
RANGE = 4.0
"""Range of a force in its standard deviations."""
TO_SCALE = "true to the stated areas and sensors' scales"
"""What masses and loads are without a known load: an error of all force readings in common is that of all masses."""
WORKING_PRESSURE = 2e7
"""Pressure [Pa] up to which an actuator works at least that states no relief pressure."""
LOADED = 1e-6
"""Part of the largest effect of a load from which on it counts as loading a balance or joint."""
_OF_INSTRUMENTS = "with scale errors of the force readings, of areas, and tilt of the base"
_OF_PRIOR = "mostly the machine file's confidence"
_SEVERITY = (Usable.YES, Usable.UNTESTED, Usable.NO)


def scale_assumed() -> Diagnostic:
    """What masses assume where no force is known."""
    return Diagnostic.of("scale of force readings assumed exact", (), {}, (
        "Force readings are assumed to be right in scale: a common relative error of all of them, as of piston areas "
        "or sensors' scales, becomes that of the mass."),
        "State with --gain-error how large their relative errors may be. In weigh, one known load determines them "
        "(--known).")


def claims(found: Identification, parameters: ParameterTable) -> tuple[Claim, ...]:
    """What an identification with this table of parameters can be used for, by the figures alone."""
    spread = _spread(found)
    forces = tuple(_forces(found, spread))
    return (*forces, *_masses(found, parameters), *_weighing(found, spread), *_control(found, forces))


def _spread(found: Identification) -> Array | None:
    """Draws (d, p) of the error of ψ by the intervals; None where the method has none.

    Errors of gains do not count: forces are predicted, and loads weighed, as the same sensors read them.
    """
    rng = np.random.default_rng(found.seed)
    weighted = found.weighted_residuals
    if weighted.gain and found.posterior is not None:
        R, r, _ = split(triangle(*weighted.triangles))
        slope = gaussian_posterior(found.problem, R, r).slope
        return np.asarray((slope @ rng.standard_normal((slope.shape[1], DRAWS))).T)
    if found.posterior is not None:
        samples = found.posterior.samples
        return np.asarray(samples[rng.choice(len(samples), min(DRAWS, len(samples)), replace=False)] - found.psi)
    if found.intervals is not Intervals.LEAST_SQUARES:
        return None
    basis = list(found.identifiability.basis)
    R = weighted.R[:, basis] if not weighted.gain else split(triangle(*weighted.triangles))[0][:, basis]
    scale = np.linalg.norm(R, axis=0)
    drawn = np.zeros((DRAWS, len(found.psi)))
    drawn[:, basis] = np.linalg.solve(np.linalg.qr(R / scale, mode="r"), rng.standard_normal((len(basis), DRAWS))
                                      ).T / scale
    return drawn


def _states(found: Identification) -> tuple[Array, ...]:
    """Postures (s, n) within the joint limits at speeds and accelerations of the logs, and pressures if needed.

    Where the logs identify less than a motion could and the method has no priors, postures are those of the logs.
    """
    model, rng = found.problem.model, np.random.default_rng(0)
    motions = [data.plotted.motion for data in found.problem.experiments]
    q, qd, qdd = (np.concatenate([getattr(motion, key)[motion.interior] for motion in motions])
                  for key in ("q", "qd", "qdd"))
    rows = rng.integers(0, len(q), POSTURES)
    anywhere = found.uses_priors or found.identifiability.rank >= found.structural.rank
    postures = random_states(model, POSTURES, rng)[0] if anywhere else q[rows]
    return postures, qd[rows], qdd[rows], *_pressures(model, rng)


def _pressures(model: Model, rng: np.random.Generator) -> tuple[Array, ...]:
    return (rng.uniform(*PRESSURES, (POSTURES, len(model.machine.actuators))),) if model.needs_pressure else ()


def _regressor(found: Identification, *states: Array) -> Array:
    """K (s, r, p) at the identified parameters."""
    model = found.problem.model
    if model.linear:
        return model.over(model.regressor, *states)[0]
    return model.over(model.linearised, *states, found.psi)[0]


def _forces(found: Identification, spread: Array | None) -> Iterator[Claim]:
    """Force prediction of each balance that something drives: as these sensors read it, and the true force.

    The error along motions like those of the logs is that of blocks left out. In postures that no log visits there is
    the error by the intervals besides.
    """
    left, machine = found.left_out, found.problem.model.machine
    for each in machine.unmeasured_joints:
        yield Claim(Purpose.FORCE, each.joint, Usable.NO,
                  reason=f"{' and '.join(each.unmeasured)} not measured, so that no log tells the force there")
    reading = np.full(len(machine.balances), np.nan) if left is None else left.bound
    if spread is not None:
        errors = _regressor(found, *_states(found)) @ spread.T
        reading = np.hypot(reading, np.quantile(np.sqrt(np.mean(errors**2, axis=0)), LEVEL, axis=1))
    truth = np.hypot(np.sqrt(np.maximum(reading**2 - _white(found) ** 2, 0.0)), _of_instruments(found))
    condition = _region(found)
    for k, balance in enumerate(machine.balances):
        fits = [table[balance.name] for table in found.fit.values() if balance.name in table]
        if balance.name not in found.fit["train"]:
            yield Claim(Purpose.FORCE, balance.name, Usable.NO, reason="no training log tells its force")
            continue
        if not balance.actuators:
            continue
        variation = max((fit.rms / np.sqrt(1 - fit.vaf) if fit.vaf < 1 else np.inf for fit in fits
                         if np.isfinite(fit.vaf)), default=np.nan)
        untested = ("the method states no intervals" if spread is None else "" if left is not None and left.tested[k]
                    else "too few parts of the logs can be predicted without them")
        for about, bound in ((About.READING, reading[k]), (About.TRUTH, truth[k])):
            said = condition if about is About.READING else f"{condition}; {_OF_INSTRUMENTS}"
            yield judged(Purpose.FORCE, balance.name, float(bound), balance.unit, float(bound) / (RANGE * variation),
                         condition=said, untested=untested, about=about)


def _region(found: Identification) -> str:
    """The motions that were left out and predicted, in words."""
    machine, ranges = found.problem.model.machine, []
    motions = [data.plotted.motion for data in (*found.problem.experiments, *found.problem.validation)]
    for j, joint in enumerate(machine.joints):
        q = np.concatenate([motion.q[motion.interior, j] for motion in motions])
        speed = max(float(np.max(np.abs(motion.qd[motion.interior, j]), initial=0.0)) for motion in motions)
        turns = machine.position_unit(joint) == "rad"
        low, high, fast = np.array([q.min(initial=0.0), q.max(initial=0.0), speed]) * (180 / np.pi if turns else 1.0)
        unit = "°" if turns else " m"
        ranges.append(f"{joint} {low:.3g}…{high:.3g}{unit} up to {fast:.2g}{unit}/s")
    return f"RMS of motions like those of the logs, recorded the same day ({', '.join(ranges)})"


def _white(found: Identification) -> Array:
    """Standard deviation (r,) of the readings' white noise: what neighbouring residuals do not have in common."""
    problem, which = found.problem, "validation" if found.problem.validation else "train"
    steps, pairs = np.zeros((2, len(found.sigma)))
    for data, predicted in zip(problem.validation or problem.experiments, found.predictions[which], strict=True):
        shown = data.plotted
        taken = shown.inside[:, None] & shown.known
        both = taken[1:] & taken[:-1] & (np.diff(shown.motion.segment) == 0)[:, None]
        change = np.diff(np.where(taken, shown.force - predicted, 0.0), axis=0)
        steps += np.sum(np.where(both, change**2, 0.0), axis=0)
        pairs += both.sum(axis=0)
    return np.asarray(np.sqrt(steps / 2 / np.maximum(pairs, 1.0)))


def _of_instruments(found: Identification) -> Array:
    """What scale errors of force readings and areas and a tilt of the base make of each force (r,), at 95 %."""
    machine, model = found.problem.model.machine, found.problem.model
    gain, tilt = machine.faults.gain or GAIN, machine.faults.tilt or TILT
    pull = np.asarray(gravity_in_base(machine), dtype=float).ravel()
    squares, counts = np.zeros((2, len(found.sigma)))
    for data in found.problem.experiments:
        shown = data.plotted
        rows = np.flatnonzero(shown.inside)[:: max(1, int(np.sum(shown.inside)) // POSTURES)]
        force = np.where(np.isfinite(shown.force[rows]), shown.force[rows], 0.0)
        weights = model.over(model.gravity_forces, shown.motion.q[rows], found.psi)[0]
        tilted = [weights @ np.cross(axis, pull) for axis in np.eye(3)]
        squares += np.sum((gain * force) ** 2 + tilt**2 * np.sum(np.square(tilted), axis=0), axis=0)
        counts += len(rows)
    return np.asarray(NORMAL * np.sqrt(squares / np.maximum(counts, 1.0)))


def _masses(found: Identification, parameters: ParameterTable) -> Iterator[Claim]:
    """Single masses, each with its 95 % interval, and those of links with what is pinned to them."""
    names, scale = found.problem.parameters.names, _scale(found)
    places = found.problem.parameters.places(ParameterKind.MASS)
    for k in sorted(places, key=lambda k: not np.isfinite(found.value[k])):  # those that have a value first
        row = parameters[names[k]]
        never = found.structural.category[k] == NONE
        yield _mass(row.name, row.value, row.ci95, row.information_from_data or 0.0,
                    "not identified by any motion" if never else "not separable from others by these data", scale, row)
    prior = found.prior_std
    for total in found.total_masses:
        if len(total.bodies) < 2:
            continue
        before = float(np.linalg.norm(prior[found.problem.parameters.select(f"{one}.m" for one in total.bodies)]))
        share = 1 - (total.std / before) ** 2 if np.isfinite(before) and before else 1.0
        interval = (total.low, total.high) if np.isfinite(total.low) else None
        yield _mass(f"{total.link} with pinned ends", total.value, interval, share, "not determined by the data", scale)


def _scale(found: Identification) -> str:
    """What masses rest on, beside the data: the stated gains of force readings."""
    gain = found.weighted_residuals.gain
    return f"force readings' gains uncertain by {percentage(gain)} (σ)" if gain else TO_SCALE


def _mass(name: str, value: float | None, interval: tuple[float, float] | None, from_data: float, unknown: str,
          scale: str, row: ParameterRow | None = None) -> Claim:
    make = partial(judged, Purpose.MASS, name)
    if row is not None and row.identifiability == "fixed":
        return Claim(Purpose.MASS, name, Usable.UNTESTED, reason="held at a value")
    if value is None or not np.isfinite(value):
        return Claim(Purpose.MASS, name, Usable.NO, reason=unknown)
    if interval is None:
        return make(np.nan, "kg", np.nan, untested="the method states no intervals")
    half = (interval[1] - interval[0]) / 2
    return make(half, "kg", half / abs(value) if value else np.nan, condition=f"95 % intervals, {scale}",
                reason=_OF_PRIOR * (from_data < FROM_DATA))


def expected_mass(row: ParameterRow) -> Claim:
    """A mass before it is measured: whether logs that are to come will determine it.

    Args:
        row: of a design, whose `std` is the one to expect and whose value is the nominal one.
    """
    if row.std is None or not row.nominal or row.identifiability == NONE:
        never = row.identifiability == NONE
        return Claim(Purpose.MASS, row.name, Usable.NO,
                   reason="not identified by any motion" if never else "not separable from others by this motion")
    half, from_data = NORMAL * row.std, row.information_from_data or 0.0
    return judged(Purpose.MASS, row.name, half, "kg", half / abs(row.nominal), condition="expected 95 % intervals",
                  reason=_OF_PRIOR * (from_data < FROM_DATA))


def _weighing(found: Identification, spread: Array | None) -> Iterator[Claim]:
    """The error of a load at the tip that is weighed by the forces of a slow lift, without weighing the empty machine.
    """
    model, rng = found.problem.model, np.random.default_rng(1)
    machine = model.machine
    driven = np.concatenate([data.plotted.motion.qd for data in found.problem.experiments])
    speeds = np.sqrt(np.mean(driven**2, axis=0))
    q = Hanging(model).postures(random_states(model, POSTURES, rng)[0])
    effect = load_effect(model, q)
    if spread is None or not np.any(effect):
        return
    qd = SLOW * speeds * rng.choice([-1.0, 1.0], q.shape)
    K = _regressor(found, q, qd, 0 * q, *_pressures(model, rng))
    table = found.fit["validation" if "validation" in found.fit else "train"]
    sigma = np.array([table[each.name].rms if each.name in table else 0.0 for each in machine.balances])
    rate = float(np.median([1 / np.median(np.diff(data.plotted.log.t)) for data in found.problem.experiments]))
    averaged = sigma**2 * np.minimum(1.0, np.maximum(found.correlation_time, 1.0) / (rate * WEIGHED))
    std = load_std(K, effect, spread, averaged)
    middle = np.argsort(std)[POSTURES // 2]
    figure, place = NORMAL * float(std[middle]), q[middle : middle + 1]
    condition = f"95 %, {WEIGHED:g} s of a slow lift in the median posture, {TO_SCALE}"
    make = partial(judged, Purpose.WEIGHING, "", figure, "kg")
    if blind := _loaded(model, place):
        yield make(np.nan, condition=condition, untested=(
            f"no log tells the force at {' and '.join(each.joint for each in blind)}, which carries the load, too"))
        return
    most = capacity(machine, K[middle] @ found.psi, effect[middle], model.over(model.shares, place)[0][0],
                    _reached(found))
    if np.isnan(most.load):
        yield make(np.nan, condition=condition, untested=f"{most.holder} states no max_torque")
        return
    none = "" if most.load else _of_capacity(most)
    yield make(figure / most.load if most.load else np.nan, untested=none if most.missing else "", reason=none,
               condition="; ".join([condition, _of_capacity(most)][:2 if most.load else 1]))


def _loaded(model: Model, q: Array) -> tuple[UnmeasuredJoint, ...]:
    """Joints without a balance at which a load at the tip acts in a posture q (1, n)."""
    pull = np.asarray(gravity_in_base(model.machine), dtype=float).ravel()
    at_joints = np.abs(pull @ model.over(model.tip_jacobian, q)[0][0][:3])
    loaded = at_joints > LOADED * np.max(at_joints)
    return tuple(each for each in model.machine.unmeasured_joints
                 if loaded[model.machine.joints.index(each.joint)])


def load_effect(model: Model, q: Array) -> Array:
    """Forces (s, r) that a load at the tip adds to those of the balances per its mass [N/kg or N·m/kg], in postures
    q (s, n)."""
    pull = np.concatenate([np.asarray(gravity_in_base(model.machine), dtype=float).ravel(), np.zeros(3)])
    return np.asarray(model.over(model.wrench_forces, q, np.tile(pull, (len(q), 1)))[0][:, :, 0])


def load_std(K: Array, effect: Array, spread: Array, averaged: Array) -> Array:
    """Standard deviation (s,) [kg] of a load by weighted least squares over the forces in one posture each.

    Args:
        K: (s, r, p) regressor.
        effect: (s, r) of `load_effect`.
        spread: (d, p) draws of the error of ψ.
        averaged: (r,) variance of the averaged forces.
    """
    errors = K @ spread.T
    covariance = errors @ errors.transpose(0, 2, 1) / len(spread)
    driven = averaged > 0
    noisy = covariance[:, driven][:, :, driven] + np.diag(averaged[driven])
    weighed = np.linalg.solve(noisy, effect[:, driven, None])[:, :, 0]
    with np.errstate(divide="ignore"):
        return np.asarray(1 / np.sqrt(np.sum(weighed * effect[:, driven], axis=1)))


def _reached(found: Identification) -> dict[str, float]:
    """Highest pressure [Pa] of each hydraulic actuator in the logs."""
    logs = [data.plotted.log for data in found.problem.experiments]
    return {each.name: max((float(np.max(np.nan_to_num(log.channels[chamber]))) for log in logs
                            for chamber in each.chambers if chamber in log.channels), default=0.0)
            for each in found.problem.model.machine.hydraulic_actuators}


def _of_capacity(most: Capacity) -> str:
    """The capacity that a load is compared with, in words."""
    held = f"the machine holds {readable(most.load, 'kg')} there, limited by {most.holder}"
    if most.pressure is None:
        return held
    source = "logged" if most.pressure > WORKING_PRESSURE else "assumed"
    state = f" ({source}: state {most.owner} relief_pressure)" if most.missing else ""
    return f"{held} at {most.pressure / 1e5:.0f} bar{state}"


def _control(found: Identification, forces: tuple[Claim, ...]) -> Iterator[Claim]:
    """Feedforward and gravity compensation: as good as the worst actuator, if a machine can have these numbers."""
    if not forces:
        return
    worst = max((each for each in forces if each.about is About.READING or each.bound is None),
                key=lambda each: (_SEVERITY.index(each.usable), each.part or 0.0))
    condition = "feedforward and gravity compensation by the worst actuator; valves and oil are not part of it"
    try:
        calibrated_machine(found)
        broken = ""
    except ProblemError as error:
        broken = f"no machine can have these numbers: {error.what}"
    bound, part = (np.nan if each is None else each for each in (worst.bound, worst.part))
    yield judged(Purpose.CONTROL, worst.of, bound, worst.unit, part, condition=condition, about=worst.about,
                 reason=broken or worst.reason * (worst.usable is Usable.NO),
                 untested="" if broken or worst.usable is not Usable.UNTESTED else worst.reason)


def next_steps(found: Identification, claims: tuple[Claim, ...], typed: CommandLine) -> tuple[NextStep, ...]:
    """What would make an identification that a command gave usable for more, or how to use it."""
    def lacking(purpose: Purpose, usable: Usable) -> list[Claim]:
        return [claim for claim in claims if (claim.purpose, claim.usable) == (purpose, usable)]

    steps: list[NextStep] = []
    if lacking(Purpose.FORCE, Usable.UNTESTED) and "validation" not in found.fit:
        steps.append(NextStep(Action.CHECK, "Hold data out to test the prediction: --validate LOG, or --holdout 0.3.",
                              typed.again("--holdout", "0.3")))
    trained = found.fit["train"]
    steps += [NextStep(Action.MEASURE, f"For {each.joint}, {each.remedy}.")
              for each in found.problem.model.machine.unmeasured_joints]
    balances = {each.name for each in found.problem.model.machine.balances}
    if unread := [claim.of for claim in lacking(Purpose.FORCE, Usable.NO) if claim.of in balances - {*trained}]:
        steps.append(NextStep(Action.MEASURE, f"Record the force of {', '.join(unread)}, or its pressures."))
    if weak := [claim.of for claim in lacking(Purpose.FORCE, Usable.NO) if claim.of in trained]:
        check = f"Check the accuracy of the force of {weak[0]}"
        steps.append(NextStep(Action.CHECK, f"{check}.") if typed.given("--friction", "--with-geometry") else NextStep(
            Action.CHECK, f"{check}, and try other friction terms: --friction auto.",
            typed.again("--friction", "auto")))
    names, machine = found.problem.parameters.names, found.problem.model.machine.source
    possible = {names[k] for k, category in enumerate(found.structural.category) if category == FULL}
    if focus := [claim.of for claim in lacking(Purpose.MASS, Usable.NO) if claim.of in possible]:
        wanted = " ".join(f"--focus {name}" for name in focus[:3])
        steps.append(NextStep(Action.DRIVE, f"For {focus[0]}, design a motion, drive it, and add its log:",
                              f"hydroopt excite {machine} {wanted} -o motion"))
    elif not_excited := [name for k, name in enumerate(names) if found.category(k) == "not excited"]:
        steps.append(NextStep(Action.DRIVE, f"For {not_excited[0]}, design a motion, drive it, and add its log:",
                              f"hydroopt excite {machine} -o motion"))
    if not lacking(Purpose.CONTROL, Usable.NO) and not lacking(Purpose.CONTROL, Usable.UNTESTED):
        steps.append(NextStep(Action.USE, "Write the model as C:",
                              f"hydroopt codegen {typed.path()} -o {typed.path('c')}"))
    return tuple(steps)


class Capacity(NamedTuple):
    """What the actuators hold in one posture.

    Attributes:
        load: [kg] beside the machine itself; NaN where a drive states no limit.
        holder: names of the actuators that hold no more, joined by "and".
        pressure: least relief pressure [Pa] of the holder, stated or assumed; None of drives.
        missing: names of those of the holder whose limit is not stated.
    """

    load: float
    holder: str
    pressure: float | None
    missing: tuple[str, ...]

    @property
    def owner(self) -> str:
        """Whose limits are missing, before the name of the limit."""
        return "its" if len(self.missing) == 1 and self.missing[0] == self.holder else f"{' and '.join(self.missing)}'s"


def capacity(machine: Machine, force: Array, effect: Array, shares: Array, reached: Mapping[str, float]) -> Capacity:
    """The load that the actuators hold at the tip in one posture, and which of them holds no more.

    A cylinder pushes with its head side's area and pulls with its rod side's. Passive joints hold nothing and hang.

    Args:
        machine: with relief pressures and torques.
        force: (r,) that holds the machine itself; `effect` (r,) of a load per its mass.
        shares: (r, a) of the actuators in the balances.
        reached: highest pressure [Pa] of actuators in logs by name, which they work at if they state no relief.
    """
    found = []
    loaded = np.abs(effect) > LOADED * np.max(np.abs(effect))
    for balance, f, e, share in zip(machine.balances, force, effect, shares, strict=True):
        if not balance.actuators or not loaded[machine.balances.index(balance)]:
            continue
        acting = [(actuator, part) for actuator, part in zip(machine.actuators, share.tolist(), strict=True) if part]
        push = sum(abs(part) * _limits(actuator, reached)[part < 0] for actuator, part in acting)
        pull = sum(abs(part) * _limits(actuator, reached)[part > 0] for actuator, part in acting)
        room = max(0.0, (push - f) / e if e > 0 else (pull + f) / -e) if -pull <= f <= push else 0.0
        actuators = [actuator for actuator, _ in acting]
        pressures = [_pressure(each, reached) for each in actuators if not isinstance(each, Drive)]
        found.append(Capacity(np.nan if np.isnan(push) else float(room), " and ".join(each.name for each in actuators),
                              min(pressures, default=None), tuple(each.name for each in actuators if _unstated(each))))
    return min(found, key=lambda each: -1.0 if np.isnan(each.load) else each.load)


def _unstated(actuator: Actuator) -> bool:
    return (actuator.max_torque if isinstance(actuator, Drive) else actuator.relief_pressure) is None


def _pressure(actuator: Actuator, reached: Mapping[str, float]) -> float:
    assert not isinstance(actuator, Drive)
    return actuator.relief_pressure or max(WORKING_PRESSURE, reached.get(actuator.name, 0.0))


def _limits(actuator: Actuator, reached: Mapping[str, float]) -> tuple[float, float]:
    """Greatest positive and negative force [N or N·m] in magnitude; NaN where a drive states none."""
    if isinstance(actuator, Drive):
        torque = np.nan if actuator.max_torque is None else actuator.max_torque
        return torque, torque
    pressure = _pressure(actuator, reached)
    return actuator.areas[0] * pressure, actuator.areas[1] * pressure
