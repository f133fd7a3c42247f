"""The generated C says what the model in Python says, by its public functions and by formulas written out here.

How far the C may be off: for each entry of each member of an output the largest deviation over a group of states is
taken as a part of the entry's scale. That scale is the entry's largest absolute value over the states of the group,
but not less than FLOOR of the largest value that any entry of the member has in the group: an entry that cancels to
next to nothing carries the rounding of what cancelled. (Single precision has 6e-8 to lose: rates of rotation of the
Panda's tip that are zero but for the rounding of right angles are off by 3e-7 of the largest, forces too.) An entry
that is zero but for the model's own rounding, below ZERO of the largest, is held against a tenth of the largest. Where
all entries are zero the C must say zero. The bound is 1e-12 in double precision and 1e-5 in single. All inputs and
parameters are numbers that single precision can hold, and the model reckons with these in double.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import cache, cached_property

import casadi as ca
import numpy as np
import pytest

from fixtures import library
from fixtures.library import OK, OPEN_TRIANGLE, OUT_OF_STROKE, SINGULAR, SUBJECTS, Library, held, over
from fixtures.tiers import tiered
from hydroopt.codegen.folder import STATUSES
from hydroopt.codegen.routines import ROUTINES
from hydroopt.codegen.symbols import DETERMINED
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.geometry import Geometry
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.joints_from_readings import joints_from_readings
from hydroopt.model.kinematics import coordinates, gravity_in_base
from hydroopt.model.model import Model
from hydroopt.model.regressor import Dynamics

Array = np.ndarray
Values = dict[str, Array]

EVERY = (*SUBJECTS, *library.BALANCED, *library.LOOPED)
PARAMETRIC = ("cat215b", "panda_mukca", "spatial")
"""Subjects whose geometry is an argument, judged with changed numbers, too."""
UNCERTAIN = (*PARAMETRIC, "backhoe", "forestry_crane", "patu655_lift")
"""Subjects whose file states confidences of the geometry."""
BUILDS = (("double", "-O0"), ("double", "-O3"), ("float", "-O0"), ("float", "-O3"))
FEWER_BUILDS = {"panda_mukca": (("double", "-O3"), ("float", "-O0")), "spatial": (("double", "-O0"), ("float", "-O0")),
                "cat215b folded": (("double", "-O3"), ("float", "-O0"))} | dict.fromkeys(
                    (*library.BALANCED, *library.LOOPED), (("double", "-O0"), ("float", "-O0")))
"""How machines are built whose code takes a compiler long, or is much like another's."""
QUICK_BUILDS = {"cat215b": (("double", "-O0"),), "patu655_lift": (("double", "-O3"), ("float", "-O0")),
                "twin": (("double", "-O0"),)}
"""A diagonal of machines, precisions and levels that compile in a second or two; all others are slow."""


def quick(subject: str, routine: str, real: str, level: str) -> bool:
    del routine
    return (real, level) in QUICK_BUILDS.get(subject, ())


TOLERANCE = {"double": 1e-12, "float": 1e-5}
FLOOR = {"double": 1e-3, "float": 1e-1}
ZERO = 1e-13
WELL_DETERMINED = 1e-2
"""How well a posture must determine a wrench, from 0 to 1, for rounding not to grow."""
STROKE = 1e-6
"""How far a pin distance may leave the stroke [m] before it is said."""
VALVES = ("valve_feedforward", "valve_refit", "position_feedback")
PLAIN = tuple(name for name in ROUTINES if name not in ("inverse_kinematics", *VALVES))
"""Routines that every folder has in this order, as far as its machine can have them."""
ELSEWHERE = "force_parts", "forward_dynamics"
"""Routines among these that have tests of their own; the others are judged here."""


class Case:
    """What `prepare` takes, states for every routine in groups that are judged apart, and what the model says of them.

    The dynamic parameters are random; the geometry is the nominal one, or another where it is `moved`.
    """

    def __init__(self, subject: str, moved: bool) -> None:
        interface = library.subject(subject, "double").interface
        self.names = interface.kinds["geometry"].names
        self.stated, self.rng = interface.machine, np.random.default_rng([EVERY.index(subject), moved])
        psi, free = interface.complete.parameters, interface.chain.parameters
        values = dict(interface.values)
        values["psi"] = psi.nominal + 0.3 * psi.scale * self.rng.standard_normal(len(psi))
        self.machine = self.stated
        if "geometry" in values:
            # so little that no cylinder comes near a dead point
            step = moved * np.minimum(free.scale, 0.02) * self.rng.uniform(-1, 1, len(free))
            values["geometry"] = held(np.clip(free.nominal + step, free.lower, free.upper))
            self.machine = library.changed(interface.chain, values["geometry"])
        self.values = {name: held(array) for name, array in values.items()}
        self.chain = KinematicModel(self.machine)
        self.model, self.reduced = Model(self.machine), Model(self.machine, actuator_inertia=False)
        self.determined: dict[str, Array] = {}
        self.groups = {name: {key: array if key == "length" and name == "ulp of double" else held(array)
                              for key, array in group.items()} for name, group in self._groups()}

    def _groups(self) -> Iterator[tuple[str, Values]]:
        machine, rng = self.machine, self.rng
        joints = [link.joint for link in self.chain.links if link.joint.independent]
        own = [machine.link(name).joint for name in machine.joints]
        lower, upper = np.array([joint.range for joint in joints]).T

        def some(count: int, speed: float) -> Values:
            q, qd, qdd = library.subjects.states(machine, rng, count)
            lengths = self.lengths(q)
            return {"q": q, "qd": speed * qd, "qdd": speed * qdd, "length": lengths,
                    "stroke": rng.uniform(0, 1, lengths.shape),
                    "speed": speed * rng.uniform(-0.5, 0.5, lengths.shape),
                    "chain_q": rng.uniform(lower, upper, (count, len(joints))),
                    "fixture": rng.uniform(-3, 3, (count, 3)),
                    "reading": rng.uniform(-1e5, 3e7, (count, len(self.values["effort"]))),
                    "wrench": speed * rng.uniform(-1e4, 1e4, (count, 6)),
                    "gravity": rng.uniform(-10, 10, (count, 3)),
                    "loaded_psi": self.values["psi"] * rng.uniform(0.5, 2, (count, len(self.values["psi"])))}

        def ends(of: list) -> Array:
            limits = np.array([joint.range for joint in of])
            chosen = np.array(list(itertools.product((0, 1), repeat=len(of))))
            return limits[np.arange(len(of)), chosen[rng.permutation(len(chosen))[:64]]]

        yield "random", some(200, 1.0)
        yield "at rest", some(30, 0.0)
        yield "fast", some(50, 20.0)
        q = ends(own)
        yield "limits", some(len(q), 1.0) | {"q": q, "length": self.lengths(q),
                                             "chain_q": np.resize(ends(joints), (len(q), len(joints)))}
        if machine.cylinders and not self.others:  # several lengths at their ends contradict one another
            for name, kind in (("ulp of float", np.float32), ("ulp of double", np.float64)):
                inside = [np.nextafter(self.values[end].astype(kind), kind(towards))
                          for end, towards in (("shortest", np.inf), ("longest", 0))]
                yield name, some(2, 1.0) | {"length": np.array(inside, float)}

    def lengths(self, q: Array) -> Array:
        """Pin distances (N, c) of the hydraulic cylinders."""
        return over(self.model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, :len(self.machine.cylinders), 0]

    @cache  # noqa: B019 (cases live as long as the tests)
    def said(self, group: str, routine: str) -> Values:
        """What the model says, by member."""
        return getattr(self, routine)(self.groups[group])

    @cached_property
    def tip_jacobian(self) -> ca.Function:
        q = ca.SX.sym("q", len(self.machine.joints))
        ends = self.model.forward_kinematics(q)
        last = ends[-1] if len(self.machine.links) > 1 else ends
        columns = []
        for k in range(len(self.machine.joints)):
            spin = ca.reshape(ca.jacobian(ca.vec(last[:3, :3]), q[k]), 3, 3) @ last[:3, :3].T
            columns.append(ca.vertcat(spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]) / 2)
        return ca.Function("jacobian", [q], [ca.densify(ca.vertcat(ca.jacobian(last[:3, 3], q), ca.horzcat(*columns)))])

    def forward_kinematics(self, given: Values) -> Values:
        poses = np.stack(over(self.model.forward_kinematics, given["q"]), axis=1)
        return {"pose": poses, "jacobian": over(self.tip_jacobian, given["q"])[0]}

    def cylinder_state(self, given: Values) -> Values:
        count = len(self.machine.cylinders)
        length, speed, _, arms, _ = over(self.model.cylinder_kinematics, given["q"], given["qd"], 0 * given["q"])
        return {"length": length[:, :count, 0], "speed": speed[:, :count, 0], "lever_arm": arms[:, :count]}

    @cached_property
    def lone(self) -> dict[str, int]:
        """Joints with a triangle that one cylinder alone moves, and its place."""
        moved = [self.machine.moved_by(cylinder) for cylinder in self.machine.cylinders]
        return {joints[0]: k for k, joints in enumerate(moved) if moved.count(joints) == 1
                and self.machine.cylinders[k].name in self.model.triangles}

    @cached_property
    def others(self) -> list[int]:
        """Places of the cylinders that move other joints."""
        return [k for k, cylinder in enumerate(self.machine.cylinders)
                if not set(self.machine.moved_by(cylinder)) <= set(self.lone)]

    def joint_state(self, given: Values) -> Values:
        machine, read = self.machine, self.others
        made = {key: np.zeros((len(given["length"]), len(machine.joints))) for key in ("q", "qd")}
        for joint, k in self.lone.items():
            angle, j = self.model.triangles[machine.cylinders[k].name][1], machine.joints.index(joint)
            rate = angle.factory("rate", ["length"], ["jac:angle:length"])
            length = given["length"][:, k:k + 1]
            made["q"][:, j] = over(angle, length)[0][:, 0, 0]
            made["qd"][:, j] = over(rate, length)[0][:, 0, 0] * given["speed"][:, k]
        if read:
            moved = {joint for k in read for joint in machine.moved_by(machine.cylinders[k])}
            own = [j for j, joint in enumerate(machine.joints) if joint in moved and joint not in self.lone]
            made["q"] = joints_from_readings(self.model, made["q"], own, [f"{machine.cylinders[k].name}.length"
                                                                          for k in read], given["length"][:, read])
            arms = over(self.model.cylinder_kinematics, made["q"], 0 * made["q"], 0 * made["q"])[3][:, read]
            left = given["speed"][:, read] - np.einsum("ncj,nj->nc", arms, made["qd"])
            made["qd"][:, own] = np.einsum("njc,nc->nj", np.linalg.pinv(arms[:, :, own]), left)
        return made

    def actuator_forces(self, given: Values) -> Values:
        machine, factors = self.machine, self.model.force_from_pressure
        arms = over(self.model.cylinder_kinematics, given["q"], 0 * given["q"], 0 * given["q"])[3]
        cylinders = [c.name for c in machine.pinned]
        psi = dict(zip(self.model.parameters.names, self.values["psi"], strict=True))
        force, torque, first = [], np.zeros((len(given["q"]), len(machine.joints))), 0
        for actuator in machine.actuators:
            if actuator not in machine.measured_actuators:
                force.append(np.zeros(len(torque)))
                continue
            stated = np.array(list(factors[actuator.name].values()))
            there = slice(first, first := first + len(stated))
            assert np.array_equal(self.values["effort"][there], held(stated))
            force.append(given["reading"][:, there] @ self.values["effort"][there])
            offset = sum(psi.get(f"{actuator.name}.{key}", 0.0) for key in ("f_offset", "tau_offset"))
            rate = (arms[:, cylinders.index(actuator.name)] if isinstance(actuator, Cylinder)
                    else np.tile(np.array(machine.joints) == actuator.joint, (len(torque), 1)))
            torque += rate * (force[-1] - offset)[:, None]
        made = {"force": np.stack(force, axis=1), "torque": torque}
        return made if machine.one_each else made | {"balance": self.measured(given)}

    def inverse_dynamics(self, given: Values) -> Values:
        state = (given["q"], given["qd"], given["qdd"], self.values["psi"])
        made = {"force": over(self.model.inverse_dynamics, *state)[0][:, :, 0]}
        if self.machine.one_each:
            return made
        load = np.zeros(len(self.machine.joints))
        return made | {"actuator_force": over(self.model.actuator_forces, *state[:3], load, state[3])[0][:, :, 0]}

    def gravity_forces(self, given: Values) -> Values:
        psi = np.where([name.endswith("_offset") for name in self.model.parameters.names], 0, self.values["psi"])
        still = (given["q"], 0 * given["q"], 0 * given["q"], psi)
        return {"force": over(self.model.inverse_dynamics, *still)[0][:, :, 0]}

    def regressor(self, given: Values) -> Values:
        return {"K": over(self.model.regressor, given["q"], given["qd"], given["qdd"])[0]}

    def reduced_regressor(self, given: Values) -> Values:
        return {"K": over(self.reduced.regressor, given["q"], given["qd"], given["qdd"])[0]}

    def mass_matrix(self, given: Values) -> Values:
        state = given["q"], self.values["psi"]
        return {"mass_matrix": over(self.model.mass_matrix, *state)[0],
                "gravity": over(self.model.gravity_torques, *state)[0][:, :, 0]}

    def wrench_forces(self, given: Values) -> Values:
        return {"force": over(self.model.wrench_forces, given["q"], given["wrench"])[0][:, :, 0]}

    def measured(self, given: Values) -> Array:
        """What balances measure; unmeasured forces are such as leave nothing in the equations of their joints."""
        machine, first = self.machine, 0
        force = np.zeros((len(given["q"]), len(machine.actuators)))
        for actuator in machine.measured_actuators:
            there = slice(first, first := first + len(actuator.effort_factors))
            force[:, machine.actuators.index(actuator)] = given["reading"][:, there] @ self.values["effort"][there]
        if machine.one_each:
            return force
        arms = over(self.model.transmission, given["q"])[0]
        return np.array([library.subjects.balances(machine, arm, arm.T @ each)
                         for arm, each in zip(arms, force, strict=True)])

    def tip_wrench(self, given: Values) -> Values:
        state = (given["q"], given["qd"], given["qdd"], self.measured(given), self.values["psi"])
        wrench, determined = over(self.model.tip_wrench, *state)
        group = next(name for name, one in self.groups.items() if one is given)
        self.determined[group] = determined[:, 0, 0]
        return {"wrench": wrench[:, :, 0]}

    def residual(self, given: Values) -> Values:
        predicted = self.inverse_dynamics(given)["force"] + self.wrench_forces(given)["force"]
        return {"residual": self.measured(given) - predicted}

    @cached_property
    def derivatives(self) -> ca.Function:
        """Derivatives of the residual by q, qd, qdd and ψ, all of the functions of the model by CasADi."""
        n, model = len(self.machine.joints), self.model
        q, qd, qdd, w = (ca.SX.sym(name, k) for name, k in (("q", n), ("qd", n), ("qdd", n), ("w", 6)))
        psi, read = ca.SX.sym("psi", len(self.values["psi"])), ca.SX.sym("read", len(self.machine.actuators))
        left = model.shares(q) @ read - model.inverse_dynamics(q, qd, qdd, psi) - model.wrench_forces(q, w)
        return ca.Function("derivatives", [q, qd, qdd, w, psi, read],
                           [ca.densify(ca.jacobian(left, x)) for x in (q, qd, qdd, psi)])

    def _derivatives(self, given: Values) -> list[Array]:
        return over(self.derivatives, given["q"], given["qd"], given["qdd"], given["wrench"], self.values["psi"],
                    self.actuator_forces(given)["force"])

    def residual_by_motion(self, given: Values) -> Values:
        return dict(zip(("by_q", "by_qd", "by_qdd"), self._derivatives(given), strict=False))

    def residual_by_parameters(self, given: Values) -> Values:
        return {"by_psi": self._derivatives(given)[3]}

    def residual_by_geometry(self, given: Values) -> Values:
        symbols = ca.SX.sym("g", len(self.values["geometry"]))
        names = self.names
        dynamics = Dynamics(Geometry(self.stated, {name: symbols[k] for k, name in enumerate(names)}),
                            coordinates(self.stated))
        w, read = ca.SX.sym("w", 6), ca.SX.sym("read", len(self.machine.actuators))
        left = (dynamics.shares @ read - dynamics.forces(ca.SX(ca.DM(self.values["psi"])))
                - dynamics.wrench_forces(w))
        function = ca.Function("by_geometry", [*dynamics.coordinates, w, read, symbols],
                               [ca.densify(ca.jacobian(left, symbols))])
        return {"by_geometry": over(function, given["q"], given["qd"], given["qdd"], given["wrench"],
                                    self.actuator_forces(given)["force"], self.values["geometry"])[0]}

    def tilted_regressor(self, given: Values) -> Values:
        model, balances, states = self.model, self.machine.balances, (given["q"], given["qd"], given["qdd"])
        K = over(model.linearised, *states, given["loaded_psi"])[0]
        along = over(model.gravity_regressor, given["q"])[0].reshape(len(K), 3, *K.shape[1:])
        change = given["gravity"] - np.asarray(gravity_in_base(self.machine)).ravel()
        arms, own = over(model.transmission, given["q"])[0], np.eye(len(self.machine.joints))
        lever = [arms[:, self.machine.actuators.index(balance.alone)] if balance.alone
                 else np.tile(own[joint], (len(K), 1))
                 for balance, joint in zip(balances, model.dynamics.kept, strict=True)]
        return {"K": K + np.einsum("nc,ncrp->nrp", change, along), "lever": np.stack(lever, axis=1),
                "by_gravity": over(model.gravity_forces, given["q"], given["loaded_psi"])[0]}

    def force_by_motion(self, given: Values) -> Values:
        made = over(self.model.force_by_motion, given["q"], given["qd"], given["qdd"], given["loaded_psi"])
        return dict(zip(("by_q", "by_qd", "by_qdd"), made, strict=True))

    def closure(self, given: Values) -> Values:
        count, tip = len(self.machine.cylinders), self.machine.calibrator is not None
        g = self.chain.parameters.nominal
        observed, by_g, by_q, _ = over(self.chain.observed_jacobians, g, given["chain_q"], tip * given["fixture"])
        measured = np.hstack([np.zeros((len(observed), 3)),
                              given["stroke"] + np.array([c.dead_length for c in self.machine.cylinders])])
        rows = slice(0 if tip else 3, 3 + count)
        made = {"residual": observed[:, rows, 0] - measured[:, rows], "by_q": by_q[:, rows]}
        return made | ({"by_geometry": by_g[:, rows]} if "geometry" in self.values else {})

    def statuses(self, group: str, routine: str, real: str) -> Array:
        """Which of the statuses are right (N, statuses): both where rounding decides whether a stroke is left."""
        given = self.groups[group]
        right = np.zeros((len(given["q"]), len(STATUSES)), dtype=bool)
        beyond: Array | float = -np.inf
        if self.machine.cylinders and routine != "forward_kinematics":
            length = given["length"] if routine == "joint_state" else self.lengths(given["q"])
            if routine == "closure":
                length = over(self.chain.lengths, self.chain.parameters.nominal, given["chain_q"])[0][:, :, 0]
            beyond = np.maximum(self.values["shortest"] - length, length - self.values["longest"]).max(axis=1) - STROKE
        rounding = 4e-6 if real == "float" else 1e-12
        right[:, OK], right[:, OUT_OF_STROKE] = beyond < rounding, beyond > -rounding
        if routine == "tip_wrench":  # single precision knows how well a posture determines a wrench to 1e-7
            rounding = 3e-7 if real == "float" else 1e-12
            right[:, SINGULAR] = self.determined[group] < DETERMINED + rounding
            right[self.determined[group] < DETERMINED - rounding, :OUT_OF_STROKE + 1] = False
        return right


@cache
def case(subject: str, *, moved: bool = False) -> Case:
    return Case(subject, moved)


def deviations(found: Array, said: Array, floor: float, least: float = 0.0) -> Array:
    """Deviations of an output's entries over N states (N, ...), each as a part of its scale, which is `least` or more.
    """
    size = np.maximum(np.abs(said).max(axis=0), least)
    scale = np.where(size < ZERO * size.max(), 0.1, np.maximum(size / max(size.max(), 1e-300), floor)) * size.max()
    return np.where(found == said, 0.0, np.abs(found - said) / np.where(scale > 0, scale, np.finfo(float).tiny))


def test_a_deviation_in_one_entry_of_one_state_is_seen() -> None:
    rng = np.random.default_rng(0)
    said = rng.standard_normal((50, 3, 4)) * np.logspace(-1, 1, 4)
    found = said.copy()
    found[17, 2, 0] += 5e-12
    off = deviations(found, said, FLOOR["double"])
    assert np.count_nonzero(off) == 1
    assert 1e-12 < off[17, 2, 0] < 1e-10
    found[17, 2, 0] = np.nan
    assert not deviations(found, said, FLOOR["double"]).max() <= 1.0
    assert deviations(np.full((2, 1), 1e-300), np.zeros((2, 1)), 1.0).max() > 1.0


def cancelled(said: Values, given: Values) -> float:
    """Derivatives by speed of the centripetal forces, of the order of twice inertia times speed: at an arm of one joint
    they do no work and leave their rounding."""
    return 2 * float(np.abs(said["by_qdd"]).max() * np.abs(given["qd"]).max())


def judge(at: Case, lib: Library, routine: str, real: str) -> None:
    constants, wrong = lib.prepare(at.values), []
    for group in at.groups:
        given, said, right = at.groups[group], at.said(group, routine), at.statuses(group, routine, real)
        status, results = lib.call(routine, constants, given, len(given["q"]))
        assert set(said) == set(results.dtype.names)
        closed = np.all([np.isfinite(array).all(axis=tuple(range(1, array.ndim))) for array in said.values()], axis=0)
        if not closed.all():
            assert routine == "joint_state"
            assert group.startswith("ulp")
            assert np.all(status[~closed] == OPEN_TRIANGLE)
        assert np.all(right[np.arange(len(status)), status][closed]), (group, status)
        closed &= status != SINGULAR
        for member in said if closed.any() else ():
            least = cancelled(said, given) if member == "by_qd" and real == "float" else 0.0
            off = deviations(results[member].astype(float)[closed], said[member][closed], FLOOR[real], least)
            if routine == "tip_wrench":  # what a posture hardly determines, rounding changes in proportion
                off *= np.minimum(1.0, at.determined[group][closed] / WELL_DETERMINED)[:, None]
            if not off.max() <= TOLERANCE[real]:
                place = np.unravel_index(np.argmax(np.where(np.isnan(off), np.inf, off)), off.shape)
                there = (np.flatnonzero(closed)[place[0]], *place[1:])
                wrong.append(f"{group}: {member}{list(map(int, place[1:]))} in state {there[0]} is "
                             f"{results[member][there]!r}, not {said[member][there]!r}: off by {off[place]:.2e}")
    assert not wrong, "\n".join(wrong)


def has(subject: str, routine: str) -> bool:
    """Whether a machine has a routine, told by its parts alone."""
    described = library.machine(subject.partition(" ")[0])
    match routine:
        case "cylinder_state" | "joint_state":
            return bool(described.cylinders)
        case "closure":
            return bool(described.cylinders or described.calibrator)
        case "residual_by_geometry":
            return subject in UNCERTAIN
    return True


PAIRS = [(subject, routine) for subject in EVERY for routine in PLAIN
         if routine not in ELSEWHERE and has(subject, routine)]


@pytest.mark.parametrize("subject", tiered(EVERY, lambda subject: subject in QUICK_BUILDS))
def test_machines_have_the_routines_that_their_parts_call_for(subject: str) -> None:
    described = library.machine(subject.partition(" ")[0])
    kinematics = () if subject in ("panda_mukca", "spatial", *library.LOOPED) else ("inverse_kinematics",)
    first, *others = (routine for routine in PLAIN if has(subject, routine))
    assert tuple(library.subject(subject, "double").routines) == (
        first, *kinematics, *others,
        *(VALVES if len(described.circuits) == len(described.actuators) else ()))


@pytest.mark.parametrize(("subject", "routine", "real", "level"), tiered((
    (subject, routine, real, level) for subject, routine in PAIRS
    for real, level in FEWER_BUILDS.get(subject, BUILDS)), quick))
def test_routines_say_what_the_model_says(subject: str, routine: str, real: str, level: str, libraries) -> None:
    judge(case(subject), libraries(subject, real, level), routine, real)


@pytest.mark.parametrize(("subject", "routine", "real", "level"), tiered((
    (subject, routine, real, level) for subject, routine in PAIRS if subject in PARAMETRIC
    for real, level in FEWER_BUILDS.get(subject, FEWER_BUILDS["panda_mukca"])), quick))
def test_prepared_anew_they_say_what_the_model_of_the_changed_machine_says(
        subject: str, routine: str, real: str, level: str, libraries) -> None:
    judge(case(subject, moved=True), libraries(subject, real, level), routine, real)


@pytest.mark.parametrize("subject", tiered(["cat215b", "panda_mukca"], lambda subject: subject == "cat215b"))
@pytest.mark.slow
def test_after_a_calibration_only_the_values_change(subject: str) -> None:
    """The code that would be generated from the calibrated machine is the code that is there already."""
    at = case(subject, moved=True)
    texts = [library.files(made) for made in (library.subject(subject, "double"), library.code(at.machine))]
    name = library.subject(subject, "double").name
    differing = {file for file in texts[0] if texts[0][file] != texts[1][file]}
    # the self-test takes a machine like the one described; the README tells nothing that depends on the values
    assert f"{name}_params.h" in differing
    assert differing <= {f"{name}_params.h", f"{name}_selftest.c"}


@pytest.mark.parametrize("subject", tiered(["patu655_lift", "cat215b", "kr300"],
                                                   lambda subject: subject == "patu655_lift"))
def test_after_an_identification_only_the_values_change(subject: str) -> None:
    made = library.subject(subject, "double")
    links = tuple(link if link.body is None else link.model_copy(update={"body": link.body.model_copy(
        update={"m": 1.1 * link.body.m})}) for link in made.interface.machine.links)
    other = library.code(made.interface.machine.model_copy(update={"links": links}))
    texts = [library.files(each) for each in (made, other)]
    differing = {file for file in texts[0] if texts[0][file] != texts[1][file]}
    assert f"{made.name}_params.h" in differing
    assert differing <= {f"{made.name}_params.h", f"{made.name}_selftest.c"}
