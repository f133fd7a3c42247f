"""What to measure next: the machine with all answers so far, what measurements are for, and what could be measured."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from pathlib import Path

import casadi as ca
import numpy as np
from scipy.linalg import block_diag

from hydroopt.errors import ProblemError
from hydroopt.estimation.combined.log_geometry import ForcesByGeometry
from hydroopt.excitation.criteria import FAINT
from hydroopt.excitation.selection.candidate_postures import random_candidates
from hydroopt.excitation.selection.goals import Goal, LoadGoal, force_goal, load_goal
from hydroopt.excitation.selection.knowledge import Knowledge
from hydroopt.excitation.selection.measurements import (
    Addition,
    Measurement,
    additions,
    equipped,
    known_load,
    levelled_base,
    motion_measurement,
    pose_measurements,
    weighed_links,
)
from hydroopt.excitation.selection.pose_problem import CombinatorialProblem, pose_problem
from hydroopt.excitation.selection.readings import PostureReadings, readings, refuse_minutes, tip_rows
from hydroopt.limits.postures import LeftOut
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.kinematics import UP
from hydroopt.model.model import Model, recent_model
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.results.json_file import FILES, Job
from hydroopt.results.verdict import Purpose
from hydroopt.simulation.passive_joints import passive_motion
from hydroopt.simulation.simulate import Trajectory, random_trajectory, sampling_rate
from hydroopt.spatial.inertia import Array
from hydroopt.spatial.poses import roll_pitch_yaw

TILT = ("base.roll", "base.pitch")
"""Names of the base's tilt."""
DURATION, MOTIONS = 30.0, 3
"""Seconds of a motion, and how many random ones stand for designed ones."""
TRIES = 10
"""Random motions in which passive joints may leave their ranges."""
TASK, TASK_RATE = 1000, 10.0
"""Seed and samples per second of the random motion in which forces are wanted where none is given."""


@dataclass(frozen=True, eq=False)
class WhatNextProblem(CombinatorialProblem):
    """What to measure next; solving never changes it.

    Attributes:
        machine: what is measured.
        answers: folders of answers so far.
        targets: standard deviations to reach, by goal: ``tip`` [m], ``force`` (part of its range), ``load`` [kg], and
            masses by name [kg].
        task: the motion in which forces are wanted, and whose speeds a load is weighed at a tenth of.
        motions: that could be driven.
        minutes: of measurements by name, and of setting up by name with ``.set_up``.
        without: measurements that cannot be taken.
        base_tilt: standard deviation [rad] of the base's roll and pitch; 0 where it stands as the file says.
        candidates: random postures of each group to choose from, drawn with `seed`.
        reserves: that postures keep of the machine's limits.

    See `what_next_problem`.
    """

    machine: Machine
    answers: tuple[Path, ...]
    targets: Mapping[str, float]
    task: Trajectory
    motions: tuple[Trajectory, ...]
    minutes: Mapping[str, float] = field(default_factory=dict)
    without: tuple[str, ...] = ()
    base_tilt: float = 0.0
    candidates: int = 600
    seed: int = 0
    reserves: Reserves = DEFAULT

    @property
    def left_out(self) -> LeftOut:
        """Random postures that were left out to keep reserves."""
        return reduce(LeftOut.with_more, (left_out for _, left_out in self._drawn), LeftOut())

    @property
    def postures(self) -> tuple[PostureReadings, ...]:
        """What can be read in candidate postures of all groups; where a fixture holds the calibrator in all of them
        also without it. Empty where nothing of the geometry is uncertain or read."""
        return tuple(there for there, _ in self._drawn)

    @cached_property
    def _drawn(self) -> tuple[tuple[PostureReadings, LeftOut], ...]:
        if not len(self.chain.parameters):
            return ()
        try:
            found = [self._candidates(self.equipped)]
        except ProblemError:
            if "tip" in self.targets:
                raise
            return ()
        own = self.equipped.calibrator
        if self.additions and np.all(found[0][0].postures.fixture != ""):
            found.append(self._candidates(self.equipped.model_copy(update={
                "calibrator": None if own is None or own.links else own, "fixtures": (), "stages": (),
                "distances": tuple(each for each in self.equipped.distances if each.measured)})))
        return tuple(found)

    def _candidates(self, machine: Machine) -> tuple[PostureReadings, LeftOut]:
        poses = pose_problem(machine, 1, priors=True, reserves=self.reserves)
        drawn, left_out = random_candidates(poses, self.candidates, np.random.default_rng(self.seed))
        return PostureReadings(drawn, readings(poses.model, poses.channels)), left_out

    @cached_property
    def model(self) -> Model:
        """Bodies and friction."""
        return recent_model(self.machine)

    @cached_property
    def chain(self) -> KinematicModel:
        """The geometry."""
        return KinematicModel(self.machine)

    @property
    def of_poses(self) -> ParameterSet:
        """The numbers of the geometry, and what poses share."""
        return self.postures[0].calibration.parameters if self.postures else self.chain.parameters

    @cached_property
    def knowledge(self) -> Knowledge:
        """By the machine file and all answers."""
        parameters = self.model.parameters
        psi = parameters.information + FAINT * np.diag(parameters.scale**-2.0)
        names = (*self._geometry_names, *parameters.names)
        return Knowledge.stating(names, self._geometry_prior, psi).with_answers(self.model, self.answers)

    @cached_property
    def measurements(self) -> tuple[Measurement, ...]:
        """What could be measured."""
        found, added = list[Measurement](), {each.name: each for each in self.additions}
        for k, there in enumerate(self.postures):
            numbers = np.array([self._geometry_names.index(name) for name in there.names], dtype=int)
            found += [each for each in pose_measurements(there, numbers, added) if k == 0 or each.name in added]
        if len(self.model.parameters) and any(name != "tip" for name in self.targets):
            found.append(motion_measurement(self.model, self._by_geometry, self.motions))
            found += weighed_links(self.model, self.knowledge.geometry)
            found += [known_load(goal) for goal in self.goals if isinstance(goal, LoadGoal)]
            if self.base_tilt:
                found.append(levelled_base(self.knowledge.geometry))
        known = [each.name for each in found]
        for where, names in (("without", self.without), ("minutes", [name.removesuffix(".set_up")
                                                                     for name in self.minutes])):
            for name in names:
                if name not in known:
                    raise ProblemError(f"there is no measurement '{name}'", where=where,
                                       remedy=f"use {', '.join(known)}" if known else "leave it out")
        kept = tuple(each.priced(self.minutes) for each in found if each.name not in self.without)
        if not kept:
            raise ProblemError("nothing can be measured", where=f"machine '{self.machine.name}'", remedy=(
                "state bodies with sensors of pressures, or uncertain lengths with sensors that see them"))
        return kept

    @cached_property
    def goals(self) -> tuple[Goal, ...]:
        """What measurements are for."""
        found, knowledge = list[Goal](), self.knowledge
        p = len(knowledge.names)
        for name, target in self.targets.items():
            if name == "tip":
                if not self.postures:
                    raise ProblemError("the machine states no uncertain number of its geometry", where="target of "
                                       "'tip'", remedy="state a 'sigma' for lengths, angles and pins that may be off")
                postures = self.postures[0]
                rows = tip_rows(postures.calibration)[:, postures.free]
                if not np.any(rows):
                    raise ProblemError("the machine file states the tip as exact at known joint positions",
                                       where="target of 'tip'", remedy="state a 'sigma' for lengths and angles of "
                                       "links that may be off, or ask for --force-std, --load-std or --mass-std")
                task = np.zeros((len(rows), p))
                task[:, : rows.shape[1]] = rows
                found.append(Goal(Purpose.POSITION, "tip", "m", target, task))
            elif name == "force":
                states = (self.task.q, self.task.qd, self.task.qdd)
                found.append(force_goal(self.model, self._by_geometry, states, target))
            elif name == "load":
                found.append(load_goal(self.model, self._by_geometry, self.task, target))
            else:
                k = self.model.parameters.index(name)
                if self.model.parameters.kinds[k] is not ParameterKind.MASS:
                    raise ProblemError(f"'{name}' is no mass", where=name, remedy="name one such as boom.m")
                row = np.zeros((1, p))
                row[0, knowledge.geometry + k] = 1.0
                found.append(Goal(Purpose.MASS, name, "kg", target, row))
        return tuple(found)

    def __repr__(self) -> str:
        return f"<WhatNextProblem of {self.machine.name}: {', '.join(self.targets)}>"

    def __str__(self) -> str:
        wanted = (f"  {name} to {target:.4g}" for name, target in self.targets.items())
        known = (f"  {folder}" for folder in self.answers)
        return "\n".join([f"what to measure next of {self.machine.name}", "until standard deviations [SI] are", *wanted,
                          *(["after", *known] if self.answers else [])])

    @cached_property
    def additions(self) -> tuple[Addition, ...]:
        """What could be measured with beyond the machine file; no inclinometers where the base's tilt is uncertain,
        since poses count it as exact."""
        return tuple(each for each in additions(self.machine) if not (self.base_tilt and "[[imus]]" in each.file))

    @cached_property
    def equipped(self) -> Machine:
        """The machine with these."""
        return equipped(self.machine, self.additions)

    @cached_property
    def _geometry_names(self) -> tuple[str, ...]:
        names = self.postures[0].names if self.postures else self.chain.parameters.names
        return (*names, *TILT) if self.base_tilt else names

    @cached_property
    def _geometry_prior(self) -> Array:
        parameters = self.chain.parameters
        prior = self.postures[0].prior if self.postures else (
            parameters.information + FAINT * np.diag(parameters.scale**-2.0))
        return block_diag(prior, np.eye(2) / self.base_tilt**2) if self.base_tilt else prior

    @cached_property
    def _numbers(self) -> tuple[str, ...]:
        return tuple(name for name in self._geometry_names if name in self.chain.parameters.positions)

    @cached_property
    def _forces(self) -> ForcesByGeometry:
        return ForcesByGeometry(self.model, self._numbers)

    def _by_geometry(self, q: Array, qd: Array, qdd: Array) -> Array:
        """See `ByGeometry`; the base's roll and pitch turn gravity by as much."""
        psi, chain = self.model.parameters.nominal, self.chain.parameters
        by_numbers = self._forces.over(q, qd, qdd, psi, chain.nominal[chain.select(self._numbers)])[5]
        found = np.zeros((*by_numbers.shape[:2], self.knowledge.geometry))
        found[:, :, : by_numbers.shape[2]] = by_numbers
        if self.base_tilt:
            by_gravity = self.model.over(self.model.gravity_regressor, q)[0] @ psi
            found[:, :, -2:] = by_gravity.reshape(len(q), 3, -1).transpose(0, 2, 1) @ self._gravity_by_tilt
        return found

    @property
    def _gravity_by_tilt(self) -> Array:
        """(3, 2) of gravity in the base frame [m/s²] by the base's roll and pitch."""
        angles = ca.SX.sym("angles", 3)
        gravity = roll_pitch_yaw((angles[0], angles[1], angles[2])).T @ (-self.machine.gravity * UP)
        by_angles = ca.Function("by_angles", [angles], [ca.jacobian(gravity, angles)])
        return np.asarray(by_angles(self.machine.orientation))[:, :2]


def what_next_problem(machine: GivenMachine, answers: Sequence[str | Path] = (), *,
                      targets: Mapping[str, float] | None = None, task: Trajectory | None = None,
                      motions: Sequence[Trajectory] = (), minutes: Mapping[str, float] | None = None,
                      without: Sequence[str] = (), base_tilt: float = 0.0, seed: int = 0,
                      reserves: Reserves = DEFAULT) -> WhatNextProblem:
    """What to measure next of a machine, by what is known of it so far.

    Args:
        machine: nominal description; states how far its numbers may be off, and what they may be measured with. Of the
            folder of a calibration the covariance of its numbers counts.
        answers: folders that `identify` or `calibrate` wrote for this machine, of other measurements each.
        targets: standard deviations to reach [SI]: ``tip`` [m], root mean square over the workspace; ``force``, as a
            part of the force's range, root mean square over the task; ``load`` [kg], weighed at the tip; masses by
            name, such as ``boom.m`` [kg]. By default the tip to 10 mm.
        task: the motion in which forces are wanted; by default a random one.
        motions: that could be driven, such as designed ones; by default three random ones.
        minutes: of each part of a measurement by its name, such as ``{"station": 3.0, "motion": 5.0}``, and of setting
            up, ``{"station.set_up": 0.0}``.
        without: measurements that cannot be taken, by name.
        base_tilt: standard deviation [rad] by which the base may be off the roll and pitch that the file states.
        seed: of the postures to choose from.
        reserves: that these keep of the machine's limits.

    Raises:
        ProblemError: a target or duration is wrong, or there is no such answer or measurement.

    >>> import hydroopt
    >>> problem = hydroopt.what_next_problem("patu655_lift", targets={"force": 0.01})
    >>> [each.name for each in problem.measurements]
    ['transducers', 'motion', 'weigh.linkage', 'weigh.extension', 'weigh.payload']
    >>> plan = hydroopt.solve(problem)
    >>> plan.steps[0].measurement.name, plan.stopped
    ('motion', 'all targets are met')
    """
    folders = list(map(Path, answers))
    if isinstance(machine, str | Path) and (Path(machine) / FILES[Job.CALIBRATION]).is_file():
        folders = [Path(machine), *(folder for folder in folders if folder != Path(machine))]
    machine = machine_of(machine, "what_next_problem")
    if not (np.isfinite(base_tilt) and base_tilt >= 0):
        raise ProblemError(f"{base_tilt:g} rad is not a standard deviation", where="tilt of the base",
                           remedy="give an angle from 0 on")
    targets = dict(targets or {"tip": 0.01})
    for name, value in targets.items():
        if not (np.isfinite(value) and value > 0):
            raise ProblemError(f"a standard deviation of {value:g} cannot be reached", where=f"target of '{name}'",
                               remedy="give a positive one")
    refuse_minutes(minutes or {})
    dynamic = [name for name in targets if name != "tip"]
    if dynamic and not len(recent_model(machine).parameters):
        raise ProblemError("the machine states no body or friction", where=f"target of '{dynamic[0]}'",
                           remedy="state them in the machine file, or ask for the tip")
    driven = tuple(motions) or tuple(_random_motions(machine, MOTIONS, sampling_rate(machine), 0))
    task = next(_random_motions(machine, 1, TASK_RATE, TASK)) if task is None else task
    return WhatNextProblem(machine, tuple(folders), targets, task, driven, dict(minutes or {}),
                           tuple(without), base_tilt, seed=seed, reserves=reserves.checked())


def _random_motions(machine: Machine, count: int, rate: float, seed: int) -> Iterator[Trajectory]:
    """The first so many random motions from a seed on in which passive joints keep to their ranges.

    Raises:
        ProblemError: they do in none of `TRIES` motions.
    """
    model, left = recent_model(machine), TRIES
    for each in itertools.count(seed):
        motion = random_trajectory(model, duration=DURATION, rate=rate, seed=each)
        try:
            passive_motion(model, motion.t, (motion.q, motion.qd, motion.qdd), model.parameters.nominal)
        except ProblemError as error:
            if (left := left - 1) == 0:
                raise ProblemError(f"{error.what} in {TRIES} random motions", where="motions to compare",
                                   remedy="give motions that excite designed (--trajectory, --motion)") from error
            continue
        yield motion
        if (count := count - 1) == 0:
            return
