"""Which poses of planned and foreign tables break limits of the machine at rest, or use their reserves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.limits.postures import PostureLimits, held_link
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.logs.frames import all_of
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.results.json_file import Job
from hydroopt.results.verdict import Action, Claim, NextStep, Purpose, Usable
from hydroopt.simulation.pose_table import touches
from hydroopt.spatial.inertia import Array


class PoseOfTable(NamedTuple):
    """A pose of a table: its label, and what it breaks and what it uses the reserve of, by name of the limit.

    `judged` is false where no position of some joint of the machine is stated.
    """

    table: str
    pose: str
    judged: bool
    broken: tuple[str, ...]
    short: tuple[str, ...]


@dataclass(frozen=True, eq=False, repr=False)
class PostureCheck(Answer):
    """Which poses keep the reserves; `check_postures` returns it.

    Attributes:
        machine: whose limits count.
        reserves: that are to be kept.
        poses: of all tables.

    Example:
        >>> import hydroopt as ho
        >>> q = {"swing.q": [0.0, 0.0], "boom.q": [-0.5, 0.4], "stick.q": [1.4, 1.4]}
        >>> found = check_postures("cat215b", ho.Poses("two", channels={name: np.array(x) for name, x in q.items()}))
        >>> [(each.pose, each.broken) for each in found.poses if each.broken]
        [('2', ('workspace along z', 'boom above ground', 'stick above ground'))]
    """

    machine: Machine
    reserves: Reserves
    poses: tuple[PoseOfTable, ...]
    sources: tuple[Mapping[str, Any], ...] = ()

    job = Job.POSTURE_CHECK

    @property
    def method(self) -> str:
        """How it was computed."""
        return "the limits of the machine file, at rest"

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Limits that poses break, reserves that they use, and poses that cannot be judged."""
        found = []
        for name in dict.fromkeys(name for each in self.poses for name in each.broken):
            found.append(Diagnostic.of("poses break limit", (name,), {
                "poses": self._named([each for each in self.poses if name in each.broken])},
                "{subject} is beyond its limit in pose {poses}.",
                "Leave these poses out, or correct the limit in the machine file.", Meaning.CONTRADICTION))
        for name in dict.fromkeys(name for each in self.poses for name in each.short):
            found.append(Diagnostic.of("poses use reserve", (name,), {
                "poses": self._named([each for each in self.poses if name in each.short])},
                "{subject} has less than its reserve in pose {poses}.",
                "Leave these poses out, or state the reserve that suffices with --reserve.", Meaning.PROPERTY))
        if unknown := [each for each in self.poses if not each.judged]:
            found.append(Diagnostic.of("poses not judged", (), {"poses": self._named(unknown)}, (
                "Limits are not judged in pose {poses}, of which the table does not state all joints."),
                "Fill in their positions, or give the postures.csv of the plan."))
        return tuple(found)

    def _named(self, poses: Sequence[PoseOfTable]) -> str:
        several = len({each.table for each in self.poses}) > 1
        return ", ".join(f"{each.table} {each.pose}" if several else each.pose for each in poses)

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """Whether all poses of each table can be driven to."""
        made = []
        for table in dict.fromkeys(each.table for each in self.poses):
            own = [each for each in self.poses if each.table == table]
            broken, short = sum(bool(each.broken) for each in own), sum(bool(each.short) for each in own)
            unknown = sum(not each.judged for each in own)
            made.append(Claim(
                Purpose.DRIVING_TO, table, Usable.NO if broken or short or unknown else Usable.YES,
                condition="within what the machine file limits, at rest",
                reason=f"{broken} of {len(own)} poses break a limit" if broken else
                f"{short} of {len(own)} poses use a reserve" if short else
                f"{unknown} of {len(own)} poses do not state all joints" if unknown else ""))
        return tuple(made)

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """Other poses, where reserves are used."""
        if any(each.short for each in self.poses) and not any(each.broken for each in self.poses):
            return (NextStep(Action.MEASURE, "Leave these poses out, or plan others:",
                             f"hydroopt plan-poses {self.machine.source} -n 20 -o plan"),)
        return ()

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The tables' files."""
        return self.sources

    def details(self) -> Mapping[str, Any]:
        """Every pose."""
        return {"reserves": self.reserves._asdict(), "poses": [
            {**each._asdict(), "broken": list(each.broken), "short": list(each.short)} for each in self.poses]}


def check_postures(machine: GivenMachine, tables: Poses | Sequence[Poses], *,
                   reserves: Reserves = DEFAULT) -> PostureCheck:
    """Which poses of tables break limits of a machine at rest, or use their reserves; what `plan-poses` plans passes.

    Joints that a stage locks stand as the machine file says where the table does not. Joints of the calibrator that are
    not stated are not looked at.

    Args:
        machine: with its limits.
        tables: with positions of the joints, such as the postures.csv of a plan.
        reserves: that are to be kept.

    Raises:
        ProblemError: no pose states all joints of the machine, or a reserve leaves nothing.

    See `PostureCheck` for an example.
    """
    described = machine_of(machine, "check_postures")
    chain = KinematicModel(described)
    kept, itself = (PostureLimits(chain, each) for each in (
        reserves.checked()._replace(tracking=0.0), Reserves.none()))
    given, found = all_of(tables, (Poses,), "table of poses", described.name), list[PoseOfTable]()
    for poses in given:
        q, touch = _positions(chain, poses), touches(chain, poses)
        judged = np.all(np.isfinite(q[:, kept.places]), axis=1)
        for k in range(len(poses)):
            if not judged[k]:
                found.append(PoseOfTable(poses.name, str(poses.pose[k]), False, (), ()))
                continue
            held = held_link(described, str(poses.fixture[k]), str(touch[k]))
            broken, short = (tuple(name for name, bad in limits.broken(q[k: k + 1], held=held, closed=True).items()
                                   if bad[0]) for limits in (itself, kept))
            found.append(PoseOfTable(poses.name, str(poses.pose[k]), True, broken,
                                     tuple(name for name in short if name not in broken)))
    if not any(each.judged for each in found):
        raise ProblemError("no pose states the positions of all joints of the machine", where=given[0].name,
                           remedy="give the postures.csv that plan-poses writes, or fill in " + ", ".join(
                               f"{joint}.q" for joint in described.joints))
    return PostureCheck(described, reserves, tuple(found), tuple(
        {"path": path, "sha256": digest, "samples": len(poses), "role": "checked"}
        for poses in given for path, digest in poses.sha256.items()))


def _positions(chain: KinematicModel, poses: Poses) -> Array:
    """Joint positions (N, n) as read, else as the stage locks them; NaN where neither says."""
    stages = {stage.name: stage.locked for stage in chain.machine.stages}
    q = np.full((len(poses), len(chain.joints)), np.nan)
    for k, joint in enumerate(chain.joints):
        read = poses.channels.get(f"{joint}.q", np.full(len(poses), np.nan))
        locked = np.array([stages.get(str(stage), {}).get(joint, np.nan) for stage in poses.stage], dtype=float)
        q[:, k] = np.where(np.isfinite(read), read, locked)
    return q
