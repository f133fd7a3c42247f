"""Closed chains: tip in its fixture, cylinder lengths and measured distances as functions of geometry and angles.

Every number of the machine file with a stated confidence is a parameter; all others are exact.
"""

from __future__ import annotations

from functools import cached_property, partial

import casadi as ca
import numpy as np

from hydroopt.kernels.native import Runner
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.addresses import Number
from hydroopt.machine.calibration_chain import Fixture
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.machine.mechanism import Mechanism
from hydroopt.model.cylinder_motion import centre_line
from hydroopt.model.pose_rows import Frames, PoseRows, inputs, measurements
from hydroopt.model.recent import Recent
from hydroopt.model.scene_graph import SceneGraph
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet, parameter_table
from hydroopt.spatial.inertia import Array
from hydroopt.spatial.poses import Pose, identity, roll_pitch_yaw
from hydroopt.support.notebook_card import Card, Shown

TINY = 1e-9
"""Length [m] that keeps a distance differentiable at zero."""
Held = Fixture | Array | PoseRows
"""A fixture of the machine, where a ball is held (3,) or (N, 3) [m], or what is zero where a target touches a datum."""


class KinematicModel(Shown):
    """Geometry of a machine with its calibrator, for the calibration of chapter 3.

    Attributes:
        machine: the machine that is modelled.
        links: all links, the calibrator's last; `joints` are the moving ones, in the order of q (n,) [rad, m], and
            `ranges` (n, 2) their lower and upper limits.
        parameters: the geometry g (p,) with stated confidences, as priors.
        tip: casadi.Function (g, q) -> ball's centre (3,) [m] in the base frame (Eq. 3.17).
        closure: (g, q, fixture (3,)) -> tip − fixture (3,) [m]: the loop's residual where all joints are known and the
            fixture is a ball.
        loop: (g, q, place (k,)) -> residuals of the loop, `loop_rows` of them: tip less fixture (3,) [m] in the
            fixture's frame; if any fixture is no ball, the tool's turn (3,) [rad] against that frame too, exact where
            it is small. `place` is the fixture's position (3,), its roll, pitch and yaw (3,) if any fixture is no ball,
            the place (3,) at which tapes end if any tape has a sensor, and what `measurements` take of a pose; `inputs`
            are the slices of these parts by name.
        measurements: rows of instruments, tapes between targets and datums, at the end of `observed`.
        far_ends: (g, q) -> far ends of the chain's links (3, number of links) [m] in the base frame.
        axes: (g, q) -> directions of the joints' axes (3, n) in the base frame.
        strokes: (g, q) -> strokes of the cylinders and distances of their pins (c,) [m] (Eq. 3.26 in space).
        lengths: (g, q) -> readings of the cylinders' length transducers (c,) [m] (Eq. 3.26 in space).
        observed: (g, q, place (k,)) -> all predicted readings of a pose (m,), see `channels`.

    >>> import hydroopt, numpy as np
    >>> model = hydroopt.KinematicModel(hydroopt.load_machine("panda_mukca"))
    >>> q = np.zeros((5, len(model.joints)))
    >>> model.over(model.tip, model.parameters.nominal, q)[0].shape
    (5, 3, 1)
    """

    def __repr__(self) -> str:
        return (f"KinematicModel('{self.machine.name}': {len(self.joints)} joints, {len(self.parameters)} uncertain "
                "numbers of its geometry)")

    def card(self) -> Card:
        """What a notebook shows: the parameters with what the machine file states of them."""
        return Card(repr(self), tables=[parameter_table(self.parameters)])

    def __init__(self, machine: GivenMachine) -> None:
        self.machine = machine = machine_of(machine, "KinematicModel")
        stated = Geometry(machine)
        self.links = stated.links
        moving = [link for link in self.links if link.joint.independent]
        self.joints = tuple(link.name for link in moving)
        self.ranges = np.array([link.joint.range for link in moving])
        self.parameters = _parameters(machine, stated.numbers)
        self.oriented = any(fixture.kind != "ball" for fixture in machine.fixtures)
        self.taped = any(machine.sensor(f"{link.name}.distance") for link in machine.chain)
        sizes = {"fixture": 3, **({"turn": 3} if self.oriented else {}), **({"tape": 3} if self.taped else {}),
                 **inputs(machine)}
        bounds = np.cumsum([0, *sizes.values()])
        self.inputs = {name: slice(int(a), int(b)) for name, a, b in zip(sizes, bounds, bounds[1:], strict=False)}
        self.place_size = int(bounds[-1])
        self.loop_rows = 6 if self.oriented else 3
        g, q, fixture = (ca.SX.sym("g", len(self.parameters)), ca.SX.sym("q", len(self.joints)),
                         ca.SX.sym("fixture", 3))
        place = ca.SX.sym("place", self.place_size)
        self._mechanism = Mechanism(machine)
        self.geometry = Geometry(machine, {name: g[k] for k, name in enumerate(self.parameters.names)})
        deflected = self._deflected(q)
        poses = self._poses(deflected)
        chain = [link.name for link in machine.chain]
        ends = [poses[name] @ self.geometry.far_end(name) for name in chain]
        tip = ends[-1].point(self.geometry.point("tip")) if machine.calibrator else ca.SX(3, 1)
        ends_of = ca.horzcat(*(end.origin for end in ends)) if ends else ca.SX(3, 0)
        distances = ca.vertcat(*(self._pin_distance(cylinder, deflected) for cylinder in machine.cylinders))
        # a transducer measures the stroke, to which the nominal dead length is added
        dead = [self.geometry.value[f"{cylinder.name}.dead_length"] for cylinder in machine.cylinders]
        self.strokes = ca.Function("strokes", [g, q], [distances - ca.vertcat(*dead), distances], ["g", "q"],
                                   ["stroke", "distance"])
        lengths = distances + ca.vertcat(*(c.dead_length - d for c, d in zip(machine.cylinders, dead, strict=True)))
        # the last far end may coincide with the fixture, where a norm has no derivative
        tape_end = place[self.tape_end]
        tapes = ca.vertcat(*(ca.sqrt(ca.sumsqr(end.origin - tape_end) + TINY**2) for end in ends))
        self._tool = ends[-1].rotation if ends else ca.SX(3, 3)
        self.tip = ca.Function("tip", [g, q], [tip], ["g", "q"], ["tip"])
        self.closure = ca.Function("closure", [g, q, fixture], [tip - fixture], ["g", "q", "fixture"], ["gap"])
        self.far_ends = ca.Function("far_ends", [g, q], [ends_of], ["g", "q"], ["ends"])
        self.lengths = ca.Function("lengths", [g, q], [lengths], ["g", "q"], ["lengths"])
        tracked = self._tracked(tip)
        loop = self._held(tip - place[:3], place)
        self.loop = ca.Function("loop", [g, q, place], [loop], ["g", "q", "place"], ["loop"])
        self.measurements = measurements(Frames(self.geometry, poses, self._named(deflected),
                                                {name: place[where] for name, where in self.inputs.items()}))
        more = [each.rows for each in self.measurements]
        self.observed = ca.Function("observed", [g, q, place], [ca.vertcat(loop, lengths, tracked, tapes, *more)],
                                    ["g", "q", "place"], ["observed"])
        frames = {name: self._before(poses, name) for name in self.joints}
        self.axes = ca.Function("axes", [g, q], [ca.horzcat(*(frame.rotation[:, 2] for frame in frames.values()))],
                                ["g", "q"], ["axes"])
        self._axis_frame = frames
        self._symbols = g, q, tip, place
        self._end = tip if machine.calibrator else (
            poses[machine.tip] @ self.geometry.far_end(machine.tip)).origin if machine.links else tip
        self._runner = Runner()

    def scene_graph(self, geometry: Array) -> SceneGraph:
        """The bodies of machine and calibrator at a geometry (p,), for pictures."""
        numbers = dict(zip(self.parameters.names, map(float, geometry), strict=True))
        return SceneGraph(self.machine, calibrator=True, geometry=numbers)

    def loop_sines(self, g: ca.SX, q: ca.SX) -> list[ca.SX]:
        """Sines of the angles between the bars of the machine's linkages, at a geometry (p,) and joints (n,)."""
        own_g, own_q = self._symbols[:2]
        found = self._mechanism.sines(self.geometry, dict(zip(self.joints, ca.vertsplit(own_q), strict=True)))
        return ca.substitute(found, [own_g, own_q], [g, q]) if found else []

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the rows (m,) of `observed`; the first `loop_rows` are the loop's residual."""
        machine = self.machine
        turn = ("turn.x", "turn.y", "turn.z") if self.oriented else ()
        return ("gap.x", "gap.y", "gap.z", *turn, *(f"{c.name}.length" for c in machine.cylinders),
                "tip.x", "tip.y", "tip.z", *(f"{link.name}.distance" for link in machine.chain),
                *(channel for each in self.measurements for channel in each.channels))

    @cached_property
    def units(self) -> tuple[str, ...]:
        """SI units of the rows (m,) of `observed`."""
        measured = [each.unit for each in self.measurements for _ in each.channels]
        first = len(self.channels) - len(measured)
        return (*("rad" if name.startswith("turn.") else "m" for name in self.channels[:first]), *measured)

    @cached_property
    def readings(self) -> dict[int, int]:
        """Rows that take their reading as an input, and its place in `place`."""
        found: dict[int, int] = {}
        row = len(self.channels) - sum(len(each.channels) for each in self.measurements)
        for each in self.measurements:
            if each.reading:
                found |= {row + k: self.inputs[each.reading].start + k for k in range(len(each.channels))}
            row += len(each.channels)
        return found

    @cached_property
    def instruments(self) -> dict[str, list[int]]:
        """Rows of each instrument whose pose the machine file does not state."""
        unknown = {each.name for each in self.machine.instruments if not each.stands}
        found: dict[str, list[int]] = {}
        for each in self.measurements:
            if each.owner in unknown:
                found.setdefault(each.owner, []).extend(map(self.channels.index, each.channels))
        return found

    @property
    def tape_end(self) -> slice:
        """Where the end of a pose's tapes is in its `place`: the fixture where no tape has a sensor."""
        return self.inputs["tape" if self.taped else "fixture"]

    def place_of(self, held: Held, count: int) -> Array:
        """Places (count, k) of what holds the tip, see `loop`; tapes end there, too."""
        place = np.zeros((count, self.place_size))
        if isinstance(held, Fixture):
            place[:, :3] = held.position
            if self.oriented:
                place[:, 3:6] = held.orientation
        elif not isinstance(held, PoseRows):
            place[:, :3] = held
        place[:, self.tape_end] = place[:, :3]
        return place

    @cached_property
    def observed_jacobians(self) -> ca.Function:
        """(g, q, place) -> `observed` (m,) and its Jacobians by g (m, p), q (m, n) and place (m, k)."""
        g, q, _, place = self._symbols
        rows = self.observed(g, q, place)
        return ca.Function("observed_jacobians", [g, q, place],
                           [rows, ca.jacobian(rows, g), ca.jacobian(rows, q), ca.jacobian(rows, place)],
                           ["g", "q", "place"], ["observed", "by_g", "by_q", "by_place"])

    @cached_property
    def strokes_by_geometry(self) -> ca.Function:
        """(g, q) -> `strokes`, pin distances (c,) [m], and the Jacobian of the strokes by g (c, p)."""
        g, q = self._symbols[:2]
        strokes, distances = self.strokes(g, q)
        return ca.Function("strokes_by_geometry", [g, q], [strokes, distances, ca.jacobian(strokes, g)],
                           ["g", "q"], ["stroke", "distance", "by_g"])

    @cached_property
    def observed_by_angles(self) -> ca.Function:
        """(g, q, place) -> `observed` (m,) and its Jacobian by q (m, n)."""
        return self._by_angles(self.observed)

    @cached_property
    def loop_by_angles(self) -> ca.Function:
        """(g, q, place) -> `loop` (loop_rows,) and its Jacobian by q (loop_rows, n)."""
        return self._by_angles(self.loop)

    def _by_angles(self, function: ca.Function) -> ca.Function:
        g, q, _, place = self._symbols
        rows = function(g, q, place)
        return ca.Function(f"{function.name()}_by_angles", [g, q, place], [rows, ca.jacobian(rows, q)],
                           ["g", "q", "place"], [function.name(), "by_q"])

    @cached_property
    def end(self) -> ca.Function:
        """(g, q) -> `tip` or, of a machine without calibrator, the far end of its last link (3,) [m]."""
        g, q = self._symbols[:2]
        return ca.Function("end", [g, q], [self._end], ["g", "q"], ["end"])

    @cached_property
    def moved_tip(self) -> ca.Function:
        """(g, q, place) -> Jacobian of `observed` (m, 3) by the tip's place in the base frame, and the tool's turn
        (3, 3)."""
        g, q, _, place = self._symbols
        tip = ca.SX.sym("tip", 3)
        rows = ca.vertcat(self._held(tip, place), ca.SX(len(self.machine.cylinders), 1), self._tracked(tip),
                          ca.SX(len(self.machine.chain) + sum(len(each.channels) for each in self.measurements), 1))
        return ca.Function("moved_tip", [g, q, place], [ca.densify(ca.jacobian(rows, tip)), ca.densify(self._tool)],
                           ["g", "q", "place"], ["by_tip", "turn"])

    @cached_property
    def gravity_torque(self) -> ca.Function:
        """(g, q) -> gravity's generalised force (n,) [N·m, N] on the joints, by the nominal masses of all bodies."""
        g, q = self._symbols[:2]
        torque = self._gravity(q)
        return ca.Function("gravity_torque", [g, q], [ca.densify(torque)], ["g", "q"], ["torque"])

    def tip_in_frame(self, joint: str) -> ca.Function:
        """(g, q) -> tip (3,) [m] in the frame at the far end of the link before a joint, the frame of Eq. 3.22.

        With the joint at zero this is the vector s of Eq. 3.24, for a revolute joint with d added to its z.
        """
        g, q, tip, _ = self._symbols
        frame = self._axis_frame[joint]
        return ca.Function(f"tip_from_{joint}", [g, q], [frame.rotation.T @ (tip - frame.origin)], ["g", "q"], ["p"])

    def over(self, function: ca.Function, *columns: Array) -> list[Array]:
        """Evaluate a function at N poses, see `Runner.over`."""
        return self._runner.over(function, *columns)

    def _held(self, gap: ca.SX, place: ca.SX) -> ca.SX:
        """A gap (3,) in the base frame as the rows of `loop`."""
        if not self.oriented:
            return gap
        turn = roll_pitch_yaw((place[3], place[4], place[5]))
        relative = turn.T @ self._tool
        # the z axes lie along each other if the first two vanish; then the third is the sine of the turn about them
        return ca.vertcat(turn.T @ gap, -relative[1, 2], relative[0, 2], relative[1, 0])

    def _deflected(self, q: ca.SX) -> ca.SX:
        """Joint vector with the deflection of every joint under gravity by its compliance."""
        value = self.geometry.value
        if not any(f"{link.name}.compliance" in value for link in self.links):
            return q
        torque = self._gravity(q)
        return q + ca.vertcat(*(value.get(f"{name}.compliance", 0.0) for name in self.joints)) * torque

    def _gravity(self, q: ca.SX) -> ca.SX:
        """Generalised force of gravity (n,) [N·m, N] on the joints: −∂U/∂q, of links, barrels and rods."""
        machine, poses, named = self.machine, self._poses(q), self._named(q)
        bodies = [(link.body, poses[link.name]) for link in self.links]
        for cylinder in machine.cylinders:
            line, driven = centre_line(self.geometry, cylinder, named), machine.axis_of(cylinder)
            frame = self._before(poses, driven)
            bodies += [(end.body, frame @ Pose(line.turn, pin))
                       for end, pin in zip((cylinder.barrel, cylinder.rod), line.pins, strict=True)]
        turn, potential = roll_pitch_yaw(machine.orientation), ca.SX(0)
        for body, pose in bodies:
            if body is not None and body.m > 0:
                potential += body.m * machine.gravity * (turn @ pose.point(ca.DM(body.phi[1:4] / body.m)))[2]
        return -ca.gradient(potential, q)

    def _poses(self, q: ca.SX) -> dict[str, Pose]:
        """Frames P_i of all links in the base frame."""
        poses, variables = {BASE: identity()}, self._named(q)
        for link in self.links:
            joint_pose = self.geometry.joint(link.name, variables.get(link.name, 0.0))
            poses[link.name] = poses[link.parent] @ self.geometry.seat(link.name) @ joint_pose
        return poses

    def _named(self, q: ca.SX) -> dict[str, ca.SX]:
        """Positions of all moving joints, dependent ones too."""
        return self._mechanism.positions(self.geometry, {joint: q[k] for k, joint in enumerate(self.joints)})

    def _before(self, poses: dict[str, Pose], joint: str) -> Pose:
        parent = next(link.parent for link in self.links if link.name == joint)
        return poses[parent] @ self.geometry.seat(joint)

    def _pin_distance(self, cylinder: Cylinder, q: ca.SX) -> ca.SX:
        pins = [self.geometry.pin(cylinder, end, self._named(q)) for end in ("barrel", "rod")]
        return ca.norm_2(pins[1] - pins[0])

    def _tracked(self, tip: ca.SX) -> ca.SX:
        if self.machine.tracker is None:
            return tip
        turn = roll_pitch_yaw(self.geometry.turn("tracker"))
        return turn.T @ (tip - self.geometry.point("tracker"))


_recent = Recent[KinematicModel]()


def recent_chain(machine: Machine) -> KinematicModel:
    """The closed chain of a machine: one that was made before where all that the machine file states is the same.

    >>> import hydroopt
    >>> recent_chain(hydroopt.load_machine("panda_mukca")) is recent_chain(hydroopt.load_machine("panda_mukca"))
    True
    """
    return _recent.of((machine, machine.source), partial(KinematicModel, machine))


def _parameters(machine: Machine, numbers: tuple[Number, ...]) -> ParameterSet:
    """The numbers with a stated confidence, with Gaussian priors about their nominal values."""
    free, sigmas = [], []
    measurable = {each.name for each in machine.cylinders}
    unmeasured = {each.name for each in machine.pinned} - measurable  # no pose table reads the length of these parts
    units = {imu.name for imu in machine.imus}
    for number in numbers:
        owner = number.name.partition(".")[0]
        if owner in unmeasured or (owner in units and number.kind is not ParameterKind.ORIENTATION):
            continue  # where a unit sits does not matter at rest
        note = machine.notes.get(number.path)
        values = [other.value for other in numbers if other.path == number.path]
        sigma = None if note is None else note.spread(*values)
        if sigma:
            free.append(number)
            sigmas.append(sigma)
    scale = np.array(sigmas)
    # a compliance and a dead length cannot be negative
    positive = (ParameterKind.COMPLIANCE, ParameterKind.DEAD_LENGTH)
    lowest = [0.0 if number.kind in positive else -np.inf for number in free]
    lower = np.array([_bound(machine, number.path, "lower", low) for number, low in zip(free, lowest, strict=True)])
    upper = np.array([_bound(machine, number.path, "upper", np.inf) for number in free])
    return ParameterSet(tuple(number.name for number in free), tuple(number.kind for number in free),
                        tuple(number.unit for number in free), np.array([number.value for number in free]),
                        lower, upper, scale, np.diag(1 / scale**2))


def _bound(machine: Machine, path: str, key: str, default: float) -> float:
    stated = getattr(machine.notes[path], key)
    return default if stated is None else float(stated)
