"""The load that a machine carries: mass and centre of mass from logs with it and without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.change import named_parts, rounded
from hydroopt.estimation.dynamic.comparison import (
    Comparison,
    Solution,
    Wald,
    copied,
    joined,
    settle,
    stated_twice,
    wald,
)
from hydroopt.estimation.dynamic.stored_information import Session, refuse_repetition, session
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.parameter_kind import INERTIAL_KINDS, ParameterKind
from hydroopt.model.model import Model
from hydroopt.parameters.dynamic import bodies
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array

LOAD = "load"
"""Owner of the load's parameters."""
NO_LOAD = 0.05
"""p-value of no load above which none is said to be seen."""


@dataclass(frozen=True)
class Quantity:
    """A number with its standard deviation and 95 % interval, in SI; NaN where the logs do not tell it."""

    name: str
    unit: str
    value: float
    std: float
    ci95: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Payload:
    """A load, in the frame P_i of the link that carries it.

    Attributes:
        machine, link: what carries it.
        mass: [kg].
        com: the three coordinates of its centre of mass [m].
        moment: the three first moments m·com [kg·m], which may be told where mass and centre are not.
        phi: (10,) the most probable load that can exist; what is not told is a guess there.
        friction: changes of friction between the sessions, if they were asked for.
        gains: relative errors of the actuators' force readings, if they were in doubt.
        statistic, rank, freedom, p_value: F test of the hypothesis that there is no load (and no other change).
        before, after: the sessions, without and with the load.
        notes: what was done and what is not told, in plain words.
    """

    machine: Machine
    link: str
    mass: Quantity
    com: tuple[Quantity, ...]
    moment: tuple[Quantity, ...]
    phi: Array
    friction: tuple[Quantity, ...]
    gains: tuple[Quantity, ...]
    statistic: float
    rank: int
    freedom: float
    p_value: float
    before: Session
    after: Session
    notes: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """Mass and centre of mass in one sentence."""
        if self.p_value > NO_LOAD:
            known = f"; a load of {rounded(self.mass.value, self.mass.std)} kg fits as well" if np.isfinite(
                self.mass.std) else ""
            return f"No load is seen on {self.link} (p = {self.p_value:.2g}){known}."
        com, moment = (", ".join(f"{one.name[-1]} = {rounded(one.value, one.std)}" for one in some
                                 if np.isfinite(one.std)) for some in (self.com, self.moment))
        if np.isfinite(self.mass.std):
            where = f", its centre of mass lies at {com} m in the frame of that link" if com else ""
            return f"The load on {self.link} is {rounded(self.mass.value, self.mass.std)} kg{where}."
        seen = f"but its moment is {moment} kg·m in the frame of that link" if moment else "nor where it is"
        return f"These logs do not tell the mass of the load on {self.link}, {seen}."

    def __str__(self) -> str:
        return "\n".join([self.verdict, *(f"  {note}" for note in self.notes)])


def payload(machine: Machine, unloaded: Sequence[Log] | str | Path, loaded: Sequence[Log] | str | Path, *,
            link: str | None = None, friction_changes: bool = False, gain: float = 0.0,
            smoothing: Smoothing | None = None, seed: int = 0) -> Payload:
    """Mass and centre of mass of a load that one session carries and another does not.

    Both sessions share the machine's parameters; the load is a body of its own on a link. Its mass is not negative, and
    `Payload.phi` is the most probable body whose pseudo-inertia is positive definite. A scale that all forces are
    misread by, such as a motor's torque constant, changes the mass by as much; with `gain` it is an unknown of each
    actuator, which what the machine file knows about masses then holds, and the intervals tell how well.

    Args:
        machine: nominal description without the load, the same for both sessions.
        unloaded: logs, or the folder that `hydroopt identify` made of them.
        loaded: logs, or such a folder.
        link: that carries the load; the last one by default.
        friction_changes: whether friction may differ between the sessions: in gears it grows with the load.
        gain: standard deviation of the relative error of each actuator's force reading, the same in both sessions.
        smoothing: how angles are differentiated.
        seed: of the sampling of intervals.

    Raises:
        LogError: a log cannot be used.
        ProblemError: there is no such link, it cannot carry a load, or a session is of no use here.
        IdentifiabilityError: the logs tell nothing of the load.
    """
    if not 0 <= gain < 1:
        raise ProblemError(f"{gain:g} is no relative error", where="gain", remedy="give a part of one, such as 0.05")
    model = Model(machine)
    carrier = machine.links[-1].name if link is None else link
    columns = _carried(model, carrier)
    names = named_parts(model.parameters, ["friction"]) if friction_changes else ()
    with threadpool_limits(limits=1, user_api="blas"):
        first, second = session(model, unloaded, smoothing), session(model, loaded, smoothing)
        refuse_repetition(first, second)
        if gain and {len(first.triangles), len(second.triangles)} != {len(machine.actuators)}:
            raise ProblemError("the gains of actuators whose residuals were weighed together cannot be told",
                               where="gain", remedy="identify without --motion fitted, --instruments and --correlated")
        readings = first.freedom + second.freedom
        total = sum(owned.body.m for owned in bodies(machine).values())
        problem = _problem(model, columns, names, gain, mass=0.1 * total)
        test = wald(problem, *problem.rows(first, second), readings)
        if np.isfinite(test.std[0]):  # what is about the load's size decides how wide 'nearly unknown' is
            problem = _problem(model, columns, names, gain, mass=max(abs(float(test.value[0])), float(test.std[0])))
        A, b = problem.rows(first, second)
        test = wald(problem, A, b, readings)
        possible = settle(problem, A, b, intervals=False, seed=seed).x
        # Most loads are small, at the edge of physical consistency: samples on one side of the edge only would lie too
        # far from it, and intervals would not hold. Every mass and centre of mass has a consistent body.
        found = settle(replace(problem, unconstrained=(LOAD,)), A, b, intervals=True, seed=seed)
    return _payload(problem, carrier, test, found, possible, first, second)


def _carried(model: Model, link: str) -> Array:
    """(p, 10): what a body in the frame of a link adds to ψ. A locked link's load is one of the link it is fixed to.

    Raises:
        ProblemError: there is no such link, or no body stands in for it.
    """
    machine, stated = model.machine, bodies(model.machine)
    known = [one.name for one in machine.links]
    if link not in known:
        raise ProblemError(f"there is no link '{link}'", where="link", remedy=f"use one of {', '.join(known)}")
    holder = link
    while holder not in stated and holder != BASE and machine.link(holder).joint.type == "locked":
        holder = machine.link(holder).parent
    if holder not in stated:
        able = [name for name in known if name in stated]
        raise ProblemError(f"the link '{holder}' has no body in the machine file, to which a load could be added",
                           where="link", remedy=f"state one, or use one of {', '.join(able)}")
    at = np.eye(4)
    if holder != link:
        pose = model.geometry.far_end(holder) @ model.geometry.seen_from(holder, link, {})
        at[:3, :3], at[:3, 3] = ca.evalf(ca.SX(pose.rotation)).full(), ca.evalf(ca.SX(pose.origin)).full().ravel()
    columns = np.zeros((len(model.parameters), 10))
    columns[model.parameters.bodies[holder]] = np.stack([inertia.from_pseudo_inertia(at @ one @ at.T)
                                            for one in inertia.PSEUDO_BASIS]).T
    return columns


def _problem(model: Model, columns: Array, names: Sequence[str], gain: float, *, mass: float) -> Comparison:
    """Two sessions of which the second has a body more, of about this mass within the machine's reach."""
    parameters, p, n = model.parameters, len(model.parameters), len(model.machine.actuators) if gain else 0
    twice = stated_twice(parameters, names)
    chosen, c = np.eye(p)[twice], len(twice)
    unknowns = joined(parameters, _load(model.machine, mass), copied(parameters, twice), _gains(model, gain))
    nothing = np.zeros((10, p))
    return Comparison(
        model, (), unknowns=unknowns, labels=(*unknowns.names[p : p + 10], *names),
        second=np.hstack([np.eye(p) - chosen.T @ chosen, columns, chosen.T, np.zeros((p, n))]),
        null=np.hstack([np.vstack([np.eye(p), nothing, chosen, np.zeros((n, p))]),
                        np.eye(len(unknowns))[:, p + 10 + c :]]),
        change=np.eye(len(unknowns))[:, p : p + 10 + c], gains=tuple(range(p + 10 + c, p + 10 + c + n)))


def _load(machine: Machine, mass: float) -> ParameterSet:
    """A body of which hardly more is known than that it is within the machine's reach."""
    reach = sum(float(np.hypot(one.joint.a, one.joint.d)) for one in machine.links) or 1.0
    scale = mass * np.array([1.0, *[reach] * 3, *[reach**2] * 6])
    nominal = scale * np.array([1, 0, 0, 0, 1, 0, 0, 1, 0, 1])
    lower = np.array([0.0, *[-np.inf] * 9])
    wide = scale * np.array([10.0, *[1.0] * 9])
    return ParameterSet(tuple(f"{LOAD}.{name}" for name in inertia.NAMES), INERTIAL_KINDS, inertia.UNITS, nominal,
                        lower, np.full(10, np.inf), scale, np.diag(1 / wide**2))


def _gains(model: Model, gain: float) -> ParameterSet:
    names = tuple(f"{actuator.name}.gain" for actuator in model.machine.actuators) if gain else ()
    n = len(names)
    return ParameterSet(names, (ParameterKind.FORCE_GAIN,) * n, ("1",) * n, np.zeros(n), np.full(n, -np.inf),
                        np.full(n, np.inf), np.full(n, gain), np.eye(n) / (gain or 1.0) ** 2)


def _payload(problem: Comparison, link: str, test: Wald, found: Solution, possible: Array,
             first: Session, second: Session) -> Payload:
    p = len(problem.second)
    told = np.isfinite(test.std[:10])
    samples = found.posterior.samples if found.posterior is not None else np.full((2, len(found.x)), np.nan)
    load, centre = samples[:, p : p + 10], found.centre[p : p + 10]
    difference = (problem.second - np.eye(*problem.second.shape))[problem.model.parameters.select(problem.labels[10:])]
    axes = "xyz"
    notes = [*found.notes]
    unseen = [f"com_{axis}" for k, axis in enumerate(axes) if not (told[0] and told[1 + k])]
    if not told[0]:
        notes.insert(0, "The mass is not told: in these motions other numbers of the load could stand in for it.")
    elif unseen:
        notes.insert(0, f"Not told by these motions: {', '.join(unseen)}.")
    if not problem.gains:
        notes.append("Force readings are taken to be right in scale: if they are all too large by a part, so is the "
                     "mass; say how far they may be off.")
    return Payload(
        problem.model.machine, link, _quantity("m", "kg", centre[0], load[:, 0], told=told[0]),
        tuple(_quantity(f"com_{axis}", "m", centre[1 + k] / centre[0], load[:, 1 + k] / load[:, 0],
                        told=told[0] and told[1 + k]) for k, axis in enumerate(axes)),
        tuple(_quantity(f"mc_{axis}", "kg*m", centre[1 + k], load[:, 1 + k], told=told[1 + k])
              for k, axis in enumerate(axes)),
        possible[p : p + 10],
        tuple(_quantity(name, problem.unknowns.units[problem.unknowns.index(name)], row @ found.centre, samples @ row,
                        told=np.isfinite(std))
              for name, row, std in zip(problem.labels[10:], difference, test.std[10:], strict=True)),
        tuple(_quantity(problem.unknowns.names[k], "1", found.centre[k], samples[:, k], told=True)
              for k in problem.gains),
        test.statistic, test.rank, test.freedom, test.p_value, first, second, tuple(notes))


def _quantity(name: str, unit: str, value: float, samples: Array, *, told: bool) -> Quantity:
    nan = float("nan")
    if not told:
        return Quantity(name, unit, nan, nan, (nan, nan))
    low, high = np.quantile(samples, [0.025, 0.975])
    return Quantity(name, unit, float(value), float(np.std(samples)), (float(low), float(high)))
