"""What could be measured next: of what kind, in which postures, in how many minutes, and what it would tell.

Tapes between pins and inclinometers on links count also where the machine file does not state them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.inference.identifiability import structural
from hydroopt.excitation.motion.expected_accuracy import expected_accuracy
from hydroopt.excitation.selection.goals import ByGeometry, LoadGoal
from hydroopt.excitation.selection.pose_problem import Postures
from hydroopt.excitation.selection.readings import DRIVE, SET_UP, PostureReadings
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.machine.survey import TIP
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import Trajectory
from hydroopt.spatial.inertia import Array

MOTION, DRIVEN = 10.0, 2.0
"""Minutes to warm up and to clear the site, and for each motion of half a minute with its approach."""
REPEATS = 4
"""How often each motion may be driven."""
LEVEL, LEVELLED = 10.0, float(np.radians(0.05))
"""Minutes to lay a spirit level on the base and to level it or read its tilt; standard deviation [rad]."""
FETCH, HOLD = 20.0, 2.0
"""Minutes to fetch and sling a known load, and to lift it slowly in one posture."""
LOAD, LOADED = 1000.0, 5e-4
"""A known load [kg], and the standard deviation to which a test weight is known, as a part."""
WEIGH, SCALE = 90.0, 0.005
"""Minutes to take a link off, to weigh it and to put it back; standard deviation of a crane scale, as a part."""
TAPED = "3 mm"
"""Standard deviation of a tape between pins; assumed."""
MOUNTED, READ = "0.5 deg", "0.1 deg"
"""Standard deviations of an inclinometer's mounting along a link, and of its reading; assumed."""


class Addition(NamedTuple):
    """What to measure with: its name, what to do, and what to add to the machine file before.

    `once` says that its reading is the same in each posture.
    """

    name: str
    text: str
    file: str
    once: bool = False


@dataclass(frozen=True, eq=False)
class Measurement:
    """A measurement of one kind, of which some parts may be taken.

    Attributes:
        name: such as ``station``, ``motion`` or ``weigh.boom``.
        text: what to do.
        set_up: minutes before the first part; 0 once something is set up.
        minutes: of each part.
        rows: (K, u, w) what each of K parts says about w of all numbers, with errors independent and of variance 1.
        own: (w,) places of these numbers.
        postures: of the K parts; None where they have none.
        motions: of the parts, where these are motions.
        geometry_exact: whether they are identified with the geometry known so far.
        use: what to do with what was measured.
        command: that does it, with ``{machine}`` for the machine and its folder as the last word; empty where it needs
            numbers that are not known yet.
        file: what to add to the machine file before.
    """

    name: str
    text: str
    set_up: float
    minutes: float
    rows: Array
    own: NDArray[np.intp]
    postures: Postures | None = None
    motions: tuple[Trajectory, ...] = ()
    geometry_exact: bool = False
    use: str = ""
    command: str = ""
    file: str = ""

    def priced(self, minutes: Mapping[str, float]) -> Measurement:
        """With stated minutes, by its name and its name with ``.set_up``."""
        return replace(self, minutes=minutes.get(self.name, self.minutes),
                       set_up=minutes.get(f"{self.name}.set_up", self.set_up))


DOING = {"instrument": "Set up {}, and sight its targets", "datum": "Lay out {}, and touch it", "tape": "Tape {}",
         "imu": "Mount {}, and read its inclination"}
"""What to do, by the kind of reading."""


def pose_measurements(postures: PostureReadings, numbers: NDArray[np.intp],
                      added: Mapping[str, Addition]) -> Iterator[Measurement]:
    """Readings in postures: those of one instrument, tape, datum or IMU, or of the calibrator in one fixture; joints
    and transducers read along. Some are `added` by name to what the machine file states; `numbers` (f,) are the places
    of the geometry's among all."""
    readings, labels = postures.readings, postures.postures
    along = np.array([each.kind == "transducer" for each in readings], dtype=bool)
    fixed, touching = labels.fixture != "", labels.touch != ""

    def taken(name: str, text: str, kind: str, possible: NDArray[np.bool_], own: NDArray[np.bool_],
              addition: Addition | None = None) -> Iterator[Measurement]:
        places = np.flatnonzero(possible)
        if not len(places):
            return
        if addition is not None and addition.once:
            places = places[:1]
        spent = DRIVE + float(sum(each.minutes for each, mine in zip(readings, own, strict=True) if mine))
        rows = postures.rows_of(places, postures.there[places] & (along | own))
        yield Measurement(name, text if addition is None else addition.text, SET_UP[kind], spent, rows, numbers,
                          postures.postures.at(places), file="" if addition is None else addition.file,
                          use="with all poses as poses.csv, calibrate",
                          command="hydroopt calibrate {machine} poses.csv -o calibrated")

    none = np.zeros(len(readings), dtype=bool)
    for fixture in dict.fromkeys(labels.fixture[fixed].tolist()):
        yield from taken(f"calibrator.{fixture}", f"Attach the calibrator, its tip in {fixture}", "calibrator",
                         labels.fixture == fixture, none)
    for owner, kind in {each.owner: each.kind for each in readings if each.kind in DOING}.items():
        own = np.array([each.owner == owner and each.kind == kind for each in readings])
        alone = touching if kind == "datum" else ~touching
        yield from taken(owner, DOING[kind].format(owner), kind,
                         postures.there[:, own].any(axis=1) & ~fixed & alone, own, added.get(owner))
    yield from taken("transducers", "Drive to postures, and read joints and transducers", "transducer",
                     postures.there[:, along].any(axis=1) & ~fixed & ~touching, none)


def motion_measurement(model: Model, by_geometry: ByGeometry, motions: Sequence[Trajectory]) -> Measurement:
    """Motions to drive while forces are logged, each of which determines ψ and, where the geometry is off, both.

    Args:
        model: the machine.
        by_geometry: derivatives of its forces.
        motions: to choose from.
    """
    structure, made = structural(model), []
    if model.machine.imus:  # motion is planned by angles alone
        model = Model(model.machine.model_copy(update={"imus": ()}))
    for motion in motions:
        accuracy = expected_accuracy(model, motion, structure)
        by_g = by_geometry(motion.q, motion.qd, motion.qdd)
        made.append(np.hstack([np.einsum("ktn,tng->kg", accuracy.by_force, by_g), accuracy.rows]))
    most = max(map(len, made))
    rows = np.tile(np.stack([np.pad(each, ((0, most - len(each)), (0, 0))) for each in made]), (REPEATS, 1, 1))
    return Measurement("motion", "Drive motions that excite designs, and log angles and forces", MOTION, DRIVEN, rows,
                       np.arange(rows.shape[2]), motions=tuple(motions) * REPEATS, geometry_exact=True,
                       use="with its log as log.csv, identify",
                       command="hydroopt identify {machine} log.csv -o identified")


def levelled_base(f: int) -> Measurement:
    """The base's roll and pitch, the last two of the f numbers of the geometry."""
    return Measurement("level", "Level the base by a spirit level on it", 0.0, LEVEL, np.eye(2)[None] / LEVELLED,
                       np.arange(f - 2, f), use="state the orientation that it then has in the machine file")


def known_load(goal: LoadGoal) -> Measurement:
    """A known load weighed in each posture in which loads will be weighed, as `hydroopt weigh --known` uses it: forces
    say something about ψ, and errors of the geometry disturb that."""
    rows = []
    for by_numbers, effect in zip(goal.task, goal.effect, strict=True):
        noise = np.diag(goal.noise) + np.outer(effect, effect) * (LOADED * LOAD) ** 2
        rows.append(np.linalg.solve(np.linalg.cholesky(noise), by_numbers))
    made = np.array(rows)
    return Measurement("known_load", f"Lift a known load of about {LOAD:.0f} kg slowly", FETCH, HOLD, made,
                       np.arange(made.shape[2]), geometry_exact=True,
                       use="weigh with its log as --known of hydroopt weigh")


def weighed_links(model: Model, f: int) -> Iterator[Measurement]:
    """A link taken off and weighed, for each that has a mass and carries no other."""
    carrying = {link.parent for link in model.machine.links}
    for name in model.parameters.bodies:
        place = model.parameters.positions.get(f"{name}.m")
        if place is None or "." in name or name in carrying or not model.parameters.nominal[place]:
            continue
        row = np.full((1, 1, 1), 1 / (SCALE * model.parameters.nominal[place]))
        yield Measurement(f"weigh.{name}", f"Take {name} off, and weigh it", 0.0, WEIGH, row, np.array([f + place]),
                          use="identify with this mass as --prior of hydroopt identify")


def additions(machine: Machine) -> Iterator[Addition]:
    """Tapes between the pins of each link of uncertain length and along cylinders whose length nothing reads, and an
    inclinometer on each link that has none.

    >>> import hydroopt
    >>> [each.name for each in additions(hydroopt.load_machine("cat215b"))]
    ['pins_boom', 'inclination_boom', 'inclination_stick']
    """
    model = KinematicModel(machine)
    if not len(model.parameters):
        return
    taken = {*(each.name for each in machine.imus), *(each.name for each in machine.distances), *machine.target_names}
    for link in machine.links:
        ends = [other.name for other in machine.links if other.parent == link.name and other.joint.moving]
        own = machine.calibrator
        tip = own is not None and own.parent == link.name and not own.links
        if f"{link.name}.a" in model.parameters.names and link.parent != BASE and (ends or tip):
            points = [link.name, *ends[:1]]
            name, targets = f"pins_{link.name}", [f"pin_{each}" for each in points]
            if not {name, *targets} & taken:
                yield Addition(name, f"Tape between the pins of {link.name}", _tape(name, points, targets), once=True)
    for cylinder in machine.cylinders:
        if machine.sensor(f"{cylinder.name}.length") is None:
            yield Addition(cylinder.name, f"Tape between the pins of {cylinder.name}",
                           _sensor(f"{cylinder.name}.length", TAPED))
    units = {imu.link for imu in machine.imus}
    for link in machine.links:
        if link.joint.moving and link.parent != BASE and link.name not in units and (
                name := f"inclination_{link.name}") not in taken:
            yield Addition(name, f"Mount an inclinometer on {link.name}, and read it", _inclinometer(name, link.name))


def equipped(machine: Machine, added: Sequence[Addition]) -> Machine:
    """The machine with all that could be added."""
    if not added:
        return machine
    parts = dict.fromkeys(part for each in added for part in each.file.split("\n\n"))  # tapes share pins
    return read_machine("\n\n".join([dump_machine(machine), *parts]))


def _tape(name: str, points: list[str], targets: list[str]) -> str:
    ends = [*targets, TIP][:2]
    return "\n\n".join([*(
        f'[[targets]]\nname = "{target}"\nlink = "{link}"\nposition = ["0 m", "0 m", "0 m"]'
        for target, link in zip(targets, points, strict=True)),
        f'[[distances]]\nname = "{name}"\nbetween = ["{ends[0]}", "{ends[1]}"]', _sensor(f"{name}.length", TAPED)])


def _inclinometer(name: str, link: str) -> str:
    return "\n\n".join([
        f'[[imus]]\nname = "{name}"\nlink = "{link}"\nposition = ["0 m", "0 m", "0 m"]\norientation = {{ value = '
        f'["0 deg", "0 deg", "0 deg"], sigma = "{MOUNTED}", source = "assumed" }}\nrate = "50 Hz"',
        _sensor(f"{name}.pitch", READ)])


def _sensor(channel: str, accuracy: str) -> str:
    return f'[[sensors]]\nchannels = ["{channel}"]\naccuracy = "{accuracy}"\ndistribution = "gaussian"'
