"""Planned poses: what to measure, in which order, and the accuracy to expect."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hydroopt.estimation.kinematic.observability import Observability, linearise, observability
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.excitation.selection.pose_problem import (
    PoseGroup,
    PoseProblem,
    Postures,
    column_in_print,
    csv_in_print,
)
from hydroopt.excitation.selection.readings import readings
from hydroopt.limits.postures import LeftOut
from hydroopt.limits.watch import IN_PRINT, Watch, in_print
from hydroopt.logs.poses import Poses, Texts
from hydroopt.machine.machine import Machine
from hydroopt.model.scene_graph import SceneGraph
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.results.json_file import Job
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.tables import number
from hydroopt.results.verdict import Action, Claim, NextStep, Purpose, determined
from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False, repr=False)
class PosePlan(Answer):
    """Poses to measure, in the order of measuring; its parameters have the standard deviations to expect.

    Attributes:
        driven: the poses; `candidates` postures of each group, drawn with `seed`, were to choose from.
        left_out: random postures that were left out to keep reserves.

    >>> import hydroopt
    >>> problem = hydroopt.pose_problem(hydroopt.load_machine("cat215b"), 5, fixed={"ball.y": 0.0})
    >>> plan = hydroopt.solve(problem, candidates=50, seed=1)
    >>> plan
    <pose plan of cat215b by exchange, D criterion: ok, 40 parameters, 1 diagnostics>
    >>> plan.poses.stage[0], plan.poses.channels["yoke.q"].shape
    (np.str_('stick_moves'), (15,))
    >>> plan.sheet().splitlines()[0]
    '15 poses for cat215b'
    """

    driven: Postures
    candidates: int
    seed: int
    left_out: LeftOut

    job = Job.POSE_PLAN

    @property
    def problem(self) -> PoseProblem:
        """What was planned."""
        return self.driven.problem

    @property
    def q(self) -> Array:
        """(N, n) joint vectors [rad, m]."""
        return self.driven.q

    @property
    def stage(self) -> Texts:
        """(N,) stages."""
        return self.driven.stage

    @property
    def fixture(self) -> Texts:
        """(N,) fixtures."""
        return self.driven.fixture

    @property
    def machine(self) -> Machine:
        """What the poses are planned for."""
        return self.problem.machine

    @cached_property
    def calibration(self) -> CalibrationProblem:
        """The calibration problem that measuring the poses without noise gives."""
        return self.driven.calibration

    @cached_property
    def observability(self) -> Observability:
        """Which parameters these poses identify, and how well."""
        return observability(self.calibration, linearise(self.calibration, self.calibration.parameters.nominal, self.q))

    @cached_property
    def log_det(self) -> float:
        """Logarithm of the determinant of the scaled information over the identifiable directions."""
        total = self.observability.priors_as_data
        return float(np.linalg.slogdet(total.identifiable.T @ total.information @ total.identifiable)[1])

    @cached_property
    def lengths(self) -> Array:
        """(N, c) of all cylinders [m]."""
        model = self.problem.model
        return model.over(model.lengths, model.parameters.nominal, self.q)[0][:, :, 0]

    @property
    def method(self) -> str:
        """Algorithm and criterion."""
        return f"exchange, {self.problem.criterion} criterion"

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Parameters that these poses do not identify, and ways between them that use a reserve."""
        lost = tuple(name for name, std in zip(self.names, self.std, strict=True) if not np.isfinite(std))
        found: tuple[Diagnostic, ...] = (Diagnostic.of("not identified by poses", lost, {}, (
            "These poses do not identify {subject}."),
            "Fix them, add priors, or add poses and sensors that depend on them.", Meaning.PROPERTY),) if lost else ()
        if self.detours:
            limits = tuple(dict.fromkeys(name for names in self.detours.values() for name in names))
            ways = ", ".join(f"{k - 1} to {k}" for k in self.detours)
            found += (Diagnostic.of("ways use reserve", limits, {"ways": ways}, (
                "Straight ways between poses use a reserve of {subject}: {ways}."),
                "Drive one joint after another there, away from what is close.", Meaning.PROPERTY),)
        return found

    @cached_property
    def parameters(self) -> ParameterTable:
        """All parameters; `std` is the one to expect, and there is no value yet."""
        parameters, std = self.problem.parameters, dict(zip(self.names, self.std, strict=True))
        category = dict(zip(self.names, self.observability.category, strict=True))
        with np.errstate(divide="ignore"):
            prior = 1 / np.sqrt(np.diag(parameters.information))
        return ParameterTable([
            row(name, parameters.kinds[k], parameters.units[k], nominal=parameters.nominal[k], prior_std=prior[k],
                std=std.get(name, np.nan), identifiability=category.get(name, "fixed"))
            for k, name in enumerate(parameters.names)])

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """Which dimensions a calibration with these poses will determine."""
        without = "" if self.problem.priors else ", without the machine file's confidences (--priors)"
        return tuple(determined(Purpose.LENGTH, each, condition=f"expected 95 % intervals{without}",
                                unknown="not determined by these poses")
                     for each in self.parameters.rows if each.identifiability != "fixed")

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """Measure, and calibrate."""
        return (NextStep(Action.MEASURE, "Measure the poses of sheet.txt and fill their readings in poses.csv."),
                NextStep(Action.USE, "Then:", f"hydroopt calibrate {self.machine.source} "
                                              f"{self.command_line.path('poses.csv')} -o calibration"))

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """Empty: no files."""
        return ()

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints of machine and calibrator."""
        return self.problem.model.joints

    @property
    def scene(self) -> SceneGraph:
        """The bodies of machine and calibrator at the nominal geometry."""
        return self.problem.model.scene_graph(self.problem.model.parameters.nominal)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the f estimated parameters."""
        return self.observability.names

    @property
    def std(self) -> Array:
        """(f,) standard deviations to expect [SI], infinite where these poses do not identify a parameter."""
        return self.observability.std

    @cached_property
    def detours(self) -> Mapping[int, tuple[str, ...]]:
        """Poses to which joints must not all go straight from the one before, counted from 1, and the limits of the
        machine whose reserves that would use."""
        limits, found = self.problem.limits.while_resting(self.joints), dict[int, tuple[str, ...]]()
        groups = self.driven.groups
        held, closed = ([getattr(group, key)(self.machine) for group in groups] for key in ("held", "closed"))
        for k in range(1, len(self.q)):
            same = groups[k] is groups[k - 1]
            if used := limits.move(self.q[k - 1], self.q[k], held=(held[k - 1], held[k]), closed=closed[k] and same):
                found[k + 1] = used
        return found

    @property
    def ways(self) -> str:
        """How to drive from pose to pose, in words."""
        if not self.detours:
            return "From pose to pose all joints may go straight: the machine keeps its reserves on the way."
        return ("All joints may go straight from pose to pose, but for these ways, which use a reserve: " + "; ".join(
            f"{k - 1} to {k} ({', '.join(names)})" for k, names in self.detours.items()) + ".")

    @property
    def postures(self) -> Poses:
        """All joint angles as a table of poses, those that no sensor reads too, and which datums are touched: where to
        drive."""
        return self.driven.table

    @property
    def poses(self) -> Poses:
        """The table to fill in, with the channels that are read: zero where a datum is touched, all else empty, so that
        no planned position passes for a reading."""
        return self.driven.table_of({name: np.full(len(self.q), np.nan) for name in self.problem.channels})

    def details(self) -> Mapping[str, Any]:
        """How the poses were chosen, and how well they condition the calibration."""
        return {"poses": len(self.q), "criterion": self.problem.criterion, "focus": list(self.problem.focus),
                "priors": self.problem.priors, "fixed": dict(self.problem.fixed), "candidates": self.candidates,
                "seed": self.seed, "condition_number": number(self.observability.condition_number),
                "noise_amplification_index": number(self.observability.noise_amplification_index),
                "log_det": number(self.log_det), "reserves": self.problem.reserves._asdict(),
                "left_out": self.left_out._asdict(), "people": self.watch.as_dict(),
                "detours": [{"to": k, "limits": list(names)} for k, names in self.detours.items()]}

    def files(self) -> Mapping[str, str]:
        """Measuring sheet, table of poses to fill in, postures to drive to, and table of parameters."""
        return {"sheet.txt": self.sheet(), "poses.csv": csv_in_print(self.poses),
                "postures.csv": csv_in_print(self.postures), "parameters.csv": self.parameters.to_csv()}

    @cached_property
    def watch(self) -> Watch:
        """What people beside the machine keep."""
        return self.driven.watch

    def sheet(self) -> str:
        """The measuring sheet as plain text: how far to stay away, what to lock, what to move where, what to read, and
        when to stop; in the units of the table to fill in."""
        text = [self.left_out.sentence, self.ways]
        for at, group in enumerate(self.problem.groups):
            rows = at * self.problem.count + np.arange(self.problem.count)
            columns: dict[str, list[str]] = {}
            read = (name.removesuffix(".q") for name in self.problem.channels if name.endswith(".q"))
            for joint in (*group.moves, *read):
                unit, printed = self._printed(joint)
                columns[f"{joint} [{unit}]"] = printed
                columns |= {title: texts for moved, title, texts in self._read_lengths(group) if moved == joint}
            columns |= {title: texts for _, title, texts in self._read_lengths(group)}
            held = [(joint, *self._printed(joint)) for joint in group.locked]
            lock = ", ".join(f"{joint} at {angle[rows[0]]} {unit}" for joint, unit, angle in held)
            move = ", ".join(" and ".join((joint, *self.machine.moved_along(joint))) for joint in group.moves)
            text += ["", f"{group}", f"  lock: {lock or 'nothing'}", f"  move: {move or 'all joints'}",
                     *(f"  read: {each}" for each in self._to_read(group)), "", "  pose  " + "  ".join(columns)]
            text += [f"  {k + 1:4d}  " + "  ".join(f"{printed[k]:>{len(title)}}" for title, printed in columns.items())
                     for k in rows]
        return self.watch.sheet(f"{len(self.q)} poses for {self.machine.name}", *text)

    def _to_read(self, group: PoseGroup) -> tuple[str, ...]:
        """What to read in each pose of a group: with what, of what, and the columns of the table that it fills."""
        taken = readings(self.problem.model, self.problem.channels)
        between = {each.name: " to ".join(each.between) for each in self.machine.distances}
        cylinders = {cylinder.name for cylinder in self.machine.cylinders}
        tools = {"instrument": "instrument", "tape": "tape", "imu": "inclinometer", "transducer": "sensor",
                 "datum": "datum", "calibrator": "calibrator"}
        lines = []
        for each in taken:
            target = between.get(each.owner) or each.name.partition(".")[2]
            if each.kind == "datum" and each.name != group.touch:
                continue
            if each.owner in cylinders:
                what = f"length of {each.owner}, pin to pin ({tools[each.kind]})"
            elif each.name == "tip":
                what = "tip, by the tracker"
            else:
                what = f"{tools[each.kind]} {each.owner}{f': {target}' if target else ''}"
            lines.append(f"{what} -> {self._columns(each.channels)}")
        joints = [name for name in self.problem.channels if name.endswith(".q")]
        return (*([f"sensors of the joints -> {self._columns(joints)}"] if joints else []), *lines)

    def _columns(self, channels: Iterable[str]) -> str:
        """Headers of channels in the table to fill in."""
        return ", ".join(column_in_print(name, self.machine.channel_units[name]) for name in channels)

    def _read_lengths(self, group: PoseGroup) -> list[tuple[str, str, list[str]]]:
        """Of the cylinders that move without their joint being read, or have a transducer: joint, title, texts (N,)."""
        return [(joint, f"{cylinder.name} [mm]", [in_print(length, "m")[0] for length in self.lengths[:, k].tolist()])
                for k, cylinder in enumerate(self.machine.cylinders)
                if (joint := self.machine.main_joint(cylinder)) in group.moves
                or f"{cylinder.name}.length" in self.problem.channels]

    def _printed(self, joint: str) -> tuple[str, list[str]]:
        """Unit and texts (N,) of a joint's variable."""
        unit = self.machine.channel_units[f"{joint}.q"]
        return IN_PRINT[unit][0], [in_print(value, unit)[0] for value in self._positions(joint).tolist()]

    def _positions(self, joint: str) -> Array:
        """(N,) positions of a joint [rad, m], of a dependent one at the nominal geometry."""
        if joint in self.joints:
            return self.q[:, self.joints.index(joint)]
        model = self.problem.model
        rows = model.over(model.observed, model.parameters.nominal, self.q, np.zeros((len(self.q), model.place_size)))
        return rows[0][:, model.channels.index(f"{joint}.q"), 0]
