"""Which friction a machine's actuators have: sets of terms fitted to training logs and compared on held-out logs.

The fit to training logs improves with every term. Here each set has to predict held-out logs, and a larger set must do
so better than a smaller one by more than the standard error of the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.friction_candidates import STANDARD_ERRORS, Candidate, FrictionChoice
from hydroopt.estimation.dynamic.identify import Method, identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.dynamic.regressor_qr import compress
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE, random_states
from hydroopt.estimation.inference.least_squares import base_least_squares
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.actuators import Actuator, Cylinder
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model.model import Model
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.spatial.inertia import Array

TERMS = ("coulomb", "viscous", "stribeck", "reverse", "seal", "dead_zone")
"""Terms by name; ``reverse`` gives Coulomb and viscous friction a value of their own for the negative direction."""
CANDIDATES = ("none", "viscous", "coulomb", "coulomb+viscous", "coulomb+viscous+stribeck", "coulomb+viscous+reverse",
              "coulomb+viscous+seal", "coulomb+viscous+dead_zone", "coulomb+viscous+stribeck+reverse")
"""The sets that are compared by default."""
STRIBECK_SPEED, DEAD_ZONE = 0.3, 0.05
"""Where the file states none: initial Stribeck speed and dead zone, as parts of an actuator's RMS speed."""
INITIAL_SPEEDS = (0.35, 0.7, 1.4, 2.8)
"""Factors on the initial Stribeck speed: Gauss-Newton steps find the local optimum from each."""
LOWEST_SPEED = 0.25
"""Lower bound of a Stribeck speed as a part of the initial one: below, it acts where friction is not identifiable."""
BLOCKS, LONG = (6, 40), 10.0
"""Smallest and largest number of blocks of held-out samples, and their length in correlation times."""


def terms_of(text: str, machine: Machine | None = None) -> tuple[str, ...]:
    """The terms that a text such as ``coulomb+viscous+stribeck`` or ``none`` names, in the order of `TERMS`.

    Raises:
        ProblemError: a term is unknown, needs another one, or does not apply to the machine.
    """
    named = [] if text.strip() == "none" else [term.strip() for term in text.split("+")]
    for term in named:
        if term not in TERMS:
            raise ProblemError(f"'{term}' is not a friction term", where=f"friction '{text}'",
                               remedy=f"use none, or {', '.join(TERMS)} joined by +")
    for term, others in (("reverse", ("coulomb", "viscous")), ("dead_zone", ("coulomb", "stribeck", "seal"))):
        if term in named and not set(named) & set(others):
            raise ProblemError(f"'{term}' has no term to change", where=f"friction '{text}'",
                               remedy=f"add {', '.join(others[:-1])} or {others[-1]}")
    if "seal" in named and machine is not None and not machine.cylinders:
        raise ProblemError("the machine has no cylinders, so that it has no seals", where=f"friction '{text}'",
                           remedy="leave out 'seal'")
    return tuple(term for term in TERMS if term in named)


def with_friction(machine: GivenMachine, terms: str, *, speeds: Mapping[str, float] | None = None,
                  scales: Mapping[str, float] | None = None) -> Machine:
    """The machine with these friction terms, and no others, at every cylinder, motor and drive.

    Values and confidences that the file states are kept; what it states for both directions holds for each of them. All
    others are initially zero, without a prior; a Stribeck speed, ± 100 %, and a dead zone are parts of the actuator's
    speed, of identical ones parts of their mean speed. Offsets and the friction of pins and joints stay as they are.

    Args:
        machine: nominal description.
        terms: such as ``coulomb+viscous``, see `TERMS`, or ``none``.
        speeds: typical speed [m/s, rad/s] of each actuator by name; by default in random states within limits.
        scales: factors on the initial Stribeck speeds, by actuator.

    Raises:
        ProblemError: a term is unknown or does not apply to this machine.

    Example:
        >>> import hydroopt as ho
        >>> machine = ho.with_friction(ho.load_machine("patu655_lift"), "viscous", speeds={"lift_cylinder": 0.1})
        >>> machine.cylinders[0].friction.coulomb is None, machine.cylinders[0].friction.viscous
        (True, 330.0)
    """
    machine = machine_of(machine, "with_friction")
    named = terms_of(terms, machine)
    if speeds is None:
        model = Model(machine)
        speeds = _rms_speeds(model, [random_states(model, 400, np.random.default_rng(0))])
    alike = {name: one.friction for one in machine.identical for name in one.friction}
    speeds = {name: float(np.mean([speeds[other] for other in alike.get(name, (name,))])) for name in speeds}
    fading = {name: STRIBECK_SPEED * speed * (scales or {}).get(name, 1.0) for name, speed in speeds.items()}
    fading = {name: float(np.mean([fading[other] for other in alike.get(name, (name,))])) for name in fading}
    notes = dict(machine.notes)
    parts: dict[str, tuple[Any, ...]] = {}
    initial = {name: {"stribeck_speed": fading[name], "dead_zone": DEAD_ZONE * speeds[name]} for name in speeds}
    for kind in ("cylinders", "motors", "drives"):
        parts[kind] = tuple(_refitted(part, named, initial[part.name], notes) for part in getattr(machine, kind))
    return Machine.model_validate(machine.model_dump(exclude={"notes", *parts}) | parts | {"notes": notes})


def _refitted(part: Actuator, terms: Sequence[str], initial: Mapping[str, float],
              notes: dict[str, Any]) -> Any:
    """An actuator with other friction terms, with `initial` values or zero; their confidences go into `notes`."""
    stated, path = part.friction.model_dump(), f"{part.name}.friction"
    values = {key: value for key, value in stated.items() if key in ("offset", "barrel_pin", "rod_pin")}
    for term in terms:
        if term == "reverse":
            for key in {"coulomb", "viscous"} & set(terms):
                source = f"{key}_reverse" if stated[f"{key}_reverse"] is not None else key
                values[f"{key}_reverse"] = stated[source] or 0.0
                if f"{path}.{source}" in notes:
                    notes[f"{path}.{key}_reverse"] = notes[f"{path}.{source}"]
        elif term != "seal" or isinstance(part, Cylinder):
            for key in ("stribeck", "stribeck_speed") if term == "stribeck" else (term,):
                values[key] = initial.get(key, 0.0) if stated[key] is None else stated[key]
            if term == "stribeck" and stated["stribeck_speed"] is None:
                notes[f"{path}.stribeck_speed"] = Note(sigma=1.0, relative=True,
                                                     lower=LOWEST_SPEED * initial["stribeck_speed"],
                                                     source="assumed: from the speeds driven")
    for key in stated:
        if values.get(key) is None:
            notes.pop(f"{path}.{key}", None)
    return part.model_copy(update={"friction": type(part.friction).model_validate(values)})


def _rms_speeds(model: Model, motions: Sequence[tuple[Array, ...]]) -> dict[str, float]:
    """RMS speed [m/s, rad/s] of each actuator, by name, over motions q, qd, qdd."""
    squares, count = np.zeros(len(model.machine.actuators)), 0
    cylinders = [cylinder.name for cylinder in model.machine.pinned]
    for motion in motions:
        strokes = model.over(model.cylinder_kinematics, *motion[:3])[1][:, :, 0]
        for k, actuator in enumerate(model.machine.actuators):
            rates = (strokes[:, cylinders.index(actuator.name)] if isinstance(actuator, Cylinder)
                     else motion[1][:, model.machine.joints.index(actuator.joint)])
            squares[k] += np.sum(rates**2)
        count += len(motion[0])
    # an actuator that never moves has no typical speed
    return {actuator.name: float(np.sqrt(square / count)) or 1.0
            for actuator, square in zip(model.machine.actuators, squares, strict=True)}


def friction_problem(machine: Machine, logs: Sequence[Log], validation: Sequence[Log],
                     terms: str, *, smoothing: Smoothing | None = None,
                     actuator_inertia: bool = True) -> IdentificationProblem:
    """The identification problem of a machine with these friction terms; see `identification_problem`.

    Stribeck speeds that the file does not state start where the logs are fitted best.

    Raises:
        ProblemError, LogError: see `with_friction` and `identification_problem`.
    """
    terms_of(terms, machine)  # before long computations
    plain = identification_problem(with_friction(machine, "none"), logs, (), smoothing=smoothing,
                                   actuator_inertia=actuator_inertia)
    speeds = _rms_speeds(plain.model, [data.inputs() for data in plain.experiments])

    def made(scales: Mapping[str, float] | None = None) -> IdentificationProblem:
        return identification_problem(with_friction(machine, terms, speeds=speeds, scales=scales), logs, validation,
                                      smoothing=smoothing, actuator_inertia=actuator_inertia)

    problem = made()
    return problem if problem.model.linear else made(_best_start(problem))


def _best_start(problem: IdentificationProblem) -> dict[str, float]:
    """Factors, by actuator, by which Stribeck speeds fit the training data best."""
    parameters, balances = problem.parameters, problem.model.machine.balances
    heights, at = (parameters.places(kind) for kind in (ParameterKind.STRIBECK_FRICTION, ParameterKind.STRIBECK_SPEED))
    squares = []
    for part in INITIAL_SPEEDS:
        point = parameters.nominal.copy()
        point[heights], point[at] = 0.0, part * parameters.nominal[at]  # zero force: its speed has no effect
        data = compress(problem.experiments, psi=point)
        sigma = np.linalg.norm(data.triangles[:, :, -1], axis=1) / np.sqrt(np.maximum(data.samples, 1.0))
        R, r, _ = data.weighted(np.where(sigma > 0, sigma, 1.0))
        squares.append(data.squares(base_least_squares(R, r, parameters.names, RANK_TOLERANCE)[0]))
    best = np.argmin(squares, axis=0)
    return {actuator.name: INITIAL_SPEEDS[k] for balance, k in zip(balances, best, strict=True)
            for actuator in balance.actuators}


def choose_friction(machine: GivenMachine, logs: Sequence[Log], validation: Sequence[Log],
                    candidates: Sequence[str] | None = None, *, smoothing: Smoothing | None = None,
                    actuator_inertia: bool = True,
                    prepare: Callable[[IdentificationProblem], IdentificationProblem] | None = None,
                    method: Method = "sdp", tolerance: float = RANK_TOLERANCE, ridge: float | None = None,
                    intervals: bool = True, seed: int = 0) -> Estimate:
    """Fit sets of friction terms to logs and choose the one that predicts held-out logs with the fewest terms.

    Held-out samples are cut into blocks longer than the residuals' correlation time; errors of two sets are compared
    block by block. The smallest set whose mean squared error exceeds the smallest one by at most the standard error of
    that difference is chosen. That error has two parts: the scatter of the blocks, and the gain by chance of the larger
    set's additional parameters from fitting noise, 1/(number of independent samples) for each.

    Args:
        machine: nominal description; what it states of friction is a prior where a set has the term.
        logs: training data.
        validation: held-out data for the comparison.
        candidates: sets of terms such as ``coulomb+viscous+stribeck``; `CANDIDATES` if None, those with seals only
            where all pressures were measured.
        smoothing, actuator_inertia: see `identification_problem`.
        prepare: function applied to each problem before it is solved, such as ``lambda p: p.with_loss("huber")``.
        method, tolerance, ridge, intervals, seed: see `identify`; intervals are those of the chosen set.

    Returns:
        The estimate with the chosen set; its `friction_choice` compares all sets.

    Raises:
        ProblemError: nothing is held out, or a set of terms has no meaning.
        LogError: a channel is missing.
        SolverError: none of the sets could be fitted.

    Example:
        >>> import hydroopt as ho
        >>> model = ho.Model(ho.load_machine("patu655_lift"))
        >>> motions = [ho.random_trajectory(model, duration=10, rate=20, seed=k) for k in (1, 2)]
        >>> logs = [ho.simulate(model, motion, seed=k) for k, motion in enumerate(motions)]
        >>> estimate = ho.choose_friction(model.machine, logs[:1], logs[1:], ["viscous", "coulomb+viscous"],
        ...                               intervals=False)
        >>> estimate.friction_choice.terms
        'viscous'
    """
    machine = machine_of(machine, "choose_friction")
    if not validation:
        raise ProblemError("friction terms are chosen by their prediction of held-out logs, and no log is held out",
                           where="friction", remedy="give --validate or --holdout, or name one set of terms")
    if candidates is None:
        pressed = machine.cylinders and all(
            chamber in log.channels for log in (*logs, *validation) for cylinder in machine.cylinders
            for chamber in cylinder.chambers)
        candidates = [text for text in CANDIDATES if pressed or "seal" not in terms_of(text)]
    names = list(dict.fromkeys("+".join(terms_of(text, machine)) or "none" for text in candidates))
    problems: dict[str, IdentificationProblem] = {}
    fitted: dict[str, Estimate] = {}
    failed: dict[str, str] = {}
    for name in names:
        problem = friction_problem(machine, logs, validation, name, smoothing=smoothing,
                                   actuator_inertia=actuator_inertia)
        problems[name] = prepare(problem) if prepare else problem
        try:
            fitted[name] = identify(problems[name], method, tolerance=tolerance, ridge=ridge, intervals=False,
                                    seed=seed)
        except SolverError as error:
            if len(failed) == len(names) - 1:
                raise
            failed[name] = error.what
    size = {name: _size(problem, name) for name, problem in problems.items()}
    rows, blocks = _compared(fitted, failed, size)
    chosen = next(row.terms for row in rows if row.chosen)
    estimate = fitted[chosen] if not intervals else identify(problems[chosen], method, tolerance=tolerance, ridge=ridge,
                                                          seed=seed)
    return replace(estimate, friction_choice=FrictionChoice(tuple(rows), blocks))


def _size(problem: IdentificationProblem, terms: str) -> tuple[int, int]:
    """How many parameters the friction of actuators has, and how many terms."""
    parameters = problem.parameters
    owners = {actuator.name for actuator in problem.model.machine.actuators}
    of_actuators = [kind for name, kind in zip(parameters.names, parameters.kinds, strict=True)
                    if kind.is_friction and kind is not ParameterKind.PIN_FRICTION and parameters.owner(name) in owners]
    return len(of_actuators), len(terms_of(terms))


def _compared(fitted: Mapping[str, Estimate], failed: Mapping[str, str],
            size: Mapping[str, tuple[int, int]]) -> tuple[list[Candidate], int]:
    """All candidates with their errors and the one chosen, and the number of blocks."""
    train, held_out = ({name: _errors(estimate, getattr(estimate.problem, which), estimate.predictions[key])
                      for name, estimate in fitted.items()}
                     for which, key in (("experiments", "train"), ("validation", "validation")))
    sigma = np.sqrt(np.min([np.mean(error**2, axis=0) for error in train.values()], axis=0))
    sigma = np.where(sigma > 0, sigma, 1.0)
    best_fit = min(fitted, key=lambda name: float(np.mean((train[name] / sigma) ** 2)))
    samples = len(held_out[best_fit])
    wanted = samples / (LONG * np.max(fitted[best_fit].correlation_time))
    count = int(np.clip(wanted, BLOCKS[0], min(BLOCKS[1], samples)))
    blocks = {name: np.array([np.mean(part) for part in np.array_split(np.mean((error / sigma) ** 2, axis=1), count)])
              for name, error in held_out.items()}
    best = min(fitted, key=lambda name: float(np.mean(blocks[name])))
    # the squared error that superfluous parameters gain or lose by fitting noise
    independent = sum(float(np.sum(np.sum(e.inside[:, None] & e.known, axis=0) / fitted[best_fit].correlation_time))
                      for e in fitted[best_fit].problem.experiments)
    differences = {}
    for name in fitted:
        mean, error = _mean_and_error(blocks[name] - blocks[best])
        differences[name] = mean, float(np.hypot(error, abs(size[name][0] - size[best][0]) / independent))
    eligible = [name for name, (mean, error) in differences.items()
                if size[name] <= size[best] and mean <= STANDARD_ERRORS * error]
    chosen = min(eligible, key=lambda name: (size[name], float(np.mean(blocks[name]))))
    rows = []
    for name in size:
        if name in failed:
            rows.append(Candidate(name, size[name][0], np.nan, np.nan, np.nan, False, f"not fitted: {failed[name]}"))
            continue
        mean, error = _mean_and_error(blocks[name])
        rms = float(np.sqrt(mean))
        rows.append(Candidate(name, size[name][0], float(np.sqrt(np.mean((train[name] / sigma) ** 2))), rms,
                              error / (2 * rms) if rms else 0.0, name == chosen,
                              _reason(name, chosen, best, differences[name], size)))
    return rows, count


def _reason(name: str, chosen: str, best: str, difference: tuple[float, float],
            size: Mapping[str, tuple[int, int]]) -> str:
    text = f"squared error larger by {difference[0]:.2g} ± {difference[1]:.2g}"
    if name == best:
        return "smallest held-out error" if name == chosen else f"better than {chosen}, but not by its standard error"
    if name == chosen:
        return f"fewer terms than {best}, and {text} only"
    return f"{'' if size[name] <= size[best] else 'more terms, and '}{text} than of {best}"


def _errors(estimate: Estimate, data: Sequence[Experiment], predicted: Sequence[Array]) -> Array:
    """Measured minus predicted forces (N, n) of all samples that take part; 0 where a log does not tell the force."""
    errors = np.concatenate([(e.force - force)[e.inside] for e, force in zip(data, predicted, strict=True)])
    return np.where(np.isfinite(errors), errors, 0.0)


def _mean_and_error(blocks: Array) -> tuple[float, float]:
    """Mean of blocks and its standard error."""
    return float(np.mean(blocks)), float(np.std(blocks, ddof=1) / np.sqrt(len(blocks)))
