"""`Model`: every symbolic product of a machine as a named casadi.Function that can be called, derived or embedded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, partial

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.kernels.native import Runner
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model import lagrange
from hydroopt.model.joint_from_length import joint_from_length
from hydroopt.model.kinematics import coordinates
from hydroopt.model.recent import Recent
from hydroopt.model.regressor import Dynamics
from hydroopt.model.scene_graph import SceneGraph
from hydroopt.model.sensor_readings import imu_readings
from hydroopt.parameters import dynamic as dynamic_parameters
from hydroopt.parameters.force_terms import ForceTerm
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet, parameter_table
from hydroopt.parameters.unstated_bodies import joints_of_unstated_bodies
from hydroopt.spatial.inertia import Array
from hydroopt.support.notebook_card import Card, Drawn


class Model(Drawn):
    """A machine's kinematics and dynamics; n joints, r balances, p dynamic parameters.

    `actuator_inertia` tells the complete model (with barrels and rods) from the thesis's reduced one. With `calibrator`
    the bodies of the calibrator are parameters, too, the last ones; the functions here are those of the free machine,
    to which `AttachedCalibrator` adds what the calibrator does while it is attached. `terms` are force terms of the
    user's own, see `ForceTerm`. All functions
    take and return columns in SI; joint vectors are in the order of ``machine.joints``, measured forces in that of
    ``machine.balances``, which is that of the actuators where each joint has one, pressures and forces of actuators in
    that of ``machine.actuators``, parameters in that of ``model.parameters``.

    Raises:
        ProblemError: `machine` is none, nor the name or file of one; or a force term does not suit it.
        MachineError: its file cannot be used.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> model = Model(load_machine("cat215b"))
    >>> model
    Model('cat215b': 3 joints, 82 parameters, with actuator inertia)
    >>> zero = np.zeros(3)
    >>> force = model.inverse_dynamics(zero, zero, zero, model.parameters.nominal)
    >>> force.shape, model.force_units
    ((3, 1), ('N*m', 'N', 'N'))
    """

    def __init__(self, machine: GivenMachine, *, actuator_inertia: bool = True, calibrator: bool = False,
                 terms: Sequence[ForceTerm] = ()) -> None:
        self.machine = machine = machine_of(machine, "Model")
        self.actuator_inertia = actuator_inertia
        self.calibrator = calibrator
        self.terms = _fitting(terms, machine)
        self.coordinates = coordinates(machine)
        self.geometry = Geometry(machine)
        self.dynamics = Dynamics(self.geometry, self.coordinates, self.terms, actuator_inertia=actuator_inertia)
        self._runner = Runner()

    def __repr__(self) -> str:
        joints, inertia = len(self.machine.joints), "with" if self.actuator_inertia else "without"
        return (f"Model('{self.machine.name}': {joints} joint{'s' * (joints != 1)}, {len(self.parameters)} parameters, "
                f"{inertia} actuator inertia{', with calibrator' * self.calibrator})")

    def card(self) -> Card:
        """What a notebook shows: the parameters with what the machine file states of them."""
        return Card(repr(self), tables=[parameter_table(self.parameters)])

    def __reduce__(self) -> tuple[object, ...]:
        return partial(Model, actuator_inertia=self.actuator_inertia, calibrator=self.calibrator,
                       terms=self.terms), (self.machine,)

    @cached_property
    def parameters(self) -> ParameterSet:
        """Names, units, nominal values, bounds and prior of ψ (p,)."""
        return dynamic_parameters.parameter_set(self.machine, actuator_inertia=self.actuator_inertia,
                                                calibrator=self.calibrator, terms=self.terms)

    @cached_property
    def bodies(self) -> dict[str, dynamic_parameters.Owned]:
        """Bodies whose numbers are parameters, by owner."""
        return dynamic_parameters.bodies(self.machine, actuator_inertia=self.actuator_inertia,
                                         calibrator=self.calibrator)

    @cached_property
    def joints_without_nominal_forces(self) -> frozenset[str]:
        """Joints of q whose nominal forces rest on bodies that are missing or placeholders."""
        return joints_of_unstated_bodies(self.machine)

    @cached_property
    def scene_graph(self) -> SceneGraph:
        """The machine's bodies and how they move together, for pictures."""
        return SceneGraph(self.machine)

    @cached_property
    def forward_kinematics(self) -> ca.Function:
        """q (n,) → pose (4, 4) of every link's far end in the base frame, one output a link (Eq. 3.14)."""
        ends = {}
        for link in self.machine.links:
            pose = self.dynamics.links[link.name].pose @ self.geometry.far_end(link.name)
            ends[link.name] = ca.vertcat(ca.horzcat(pose.rotation, pose.origin), ca.DM([[0, 0, 0, 1]]))
        return _dense("forward_kinematics", self._q, ends)

    @cached_property
    def dependent_positions(self) -> ca.Function:
        """q (n,) → positions (d,) [rad or m] of ``machine.dependent_joints`` and their derivatives by q (d, n)."""
        tree, dependent = self.machine.tree_joints, self.machine.dependent_joints
        position = ca.vertcat(*(self.dynamics.tree.values.q[tree.index(joint)] for joint in dependent))
        return _dense("dependent_positions", self._q,
                      {"position": position, "by_q": ca.jacobian(position, self.coordinates.q)})

    @cached_property
    def cylinder_kinematics(self) -> ca.Function:
        """(q, qd, qdd) → length, speed, acceleration (c,) and lever arm ∂length/∂q with its time derivative (c, n)."""
        motions = [self.dynamics.cylinders[c.name] for c in self.machine.pinned]
        found = {key: ca.vertcat(*[getattr(m, key) for m in motions]) for key in ("length", "speed", "acceleration")}
        lever_arm = ca.jacobian(found["length"], self.coordinates.q) if motions else ca.SX(0, len(self.machine.joints))
        rate = ca.reshape(ca.jtimes(ca.vec(lever_arm), self.coordinates.q, self.coordinates.qd), lever_arm.shape)
        return _dense("cylinder_kinematics", self._motion, found | {"lever_arm": lever_arm, "lever_arm_rate": rate})

    @cached_property
    def imu_readings(self) -> ca.Function:
        """(q, qd, qdd) → readings (8, number of IMUs) without bias, in the order of ``machine.imus``: rates of rotation
        x, y, z [rad/s], specific forces x, y, z [m/s²], roll and pitch [rad]."""
        found = imu_readings(self.geometry, self.dynamics.links)
        columns = ca.reshape(ca.vertcat(*found.values()), 8, len(self.machine.imus))
        return _dense("imu_readings", self._motion, {"readings": columns})

    @cached_property
    def triangles(self) -> Mapping[str, tuple[ca.Function, ca.Function]]:
        """For every cylinder that one revolute joint moves, through a linkage or not: angle → length and length → angle
        (Eq. 3.26, 3.27).

        The second function takes the branch with the sign of the lever arm in the joint's range, and returns NaN for a
        length at which the triangle cannot close.
        """
        pairs = {}
        for cylinder in self.machine.cylinders:
            found = joint_from_length(self.geometry, cylinder)
            if found is None:
                continue
            angle, length = ca.SX.sym("angle"), ca.SX.sym("length")
            pairs[cylinder.name] = (_dense("triangle_length", {"angle": angle}, {"length": found.length(angle)}),
                                    _dense("triangle_angle", {"length": length}, {"angle": found.angle(length)}))
        return pairs

    @property
    def linear(self) -> bool:
        """Whether forces are linear in all parameters: no actuator has a Stribeck speed or a term that is not."""
        return not np.any(self.nonlinear)

    @cached_property
    def nonlinear(self) -> NDArray[np.bool_]:
        """Which parameters (p,) forces are not linear in: Stribeck speeds, and coefficients of own terms."""
        own = {name for each in self.dynamics.own_forces if not each.linear for name in each.names}
        return np.array([kind is ParameterKind.STRIBECK_SPEED or name in own for name, kind in zip(
            self.parameters.names, self.parameters.kinds, strict=True)], dtype=bool)

    @property
    def needs_pressure(self) -> bool:
        """Whether forces depend on pressures."""
        return bool(self.pressed)

    @cached_property
    def pressed(self) -> tuple[str, ...]:
        """Names of the measured cylinders whose forces depend on their pressures: by the friction of their seals, or by
        terms of the user's own."""
        own = {self.machine.actuators[each.actuator].name for each in self.dynamics.own_forces if each.pressed}
        return tuple(each.name for each in self.machine.cylinders if each.name in {*self.machine.sealed, *own})

    def refuse_seals(self, where: str) -> None:
        """Refuse a machine with friction of seals, where no pressures are available.

        Raises:
            ProblemError: names the cylinders.
        """
        if self.needs_pressure:
            raise ProblemError(f"the friction of {', '.join(self.pressed)} depends on pressures, which are not an "
                               "input here", where=where, remedy="remove 'seal' from the machine file, and own force "
                               "terms with pressures")

    @cached_property
    def _state(self) -> dict[str, ca.SX]:
        """Inputs of the forces: q, qd, qdd, and pressures if the model `needs_pressure`."""
        return self._motion | ({"pressure": self.dynamics.pressure} if self.needs_pressure else {})

    @property
    def _motion(self) -> dict[str, ca.SX]:
        return self.coordinates._asdict()

    @property
    def _q(self) -> dict[str, ca.SX]:
        return {"q": self.coordinates.q}

    @cached_property
    def _psi(self) -> dict[str, ca.SX]:
        """The parameters as an input."""
        return {"psi": ca.SX.sym("psi", len(self.parameters))}

    @cached_property
    def regressor(self) -> ca.Function:
        """(q, qd, qdd[, pressure]) → K (r, p), measured forces per parameter (Eq. 4.55).

        `pressure` (a,) [Pa] is an input if the model `needs_pressure`: p_head + p_rod of each cylinder, 0 for other
        actuators. Of a model that is not `linear` K is the derivative of the forces at the nominal parameters.
        """
        return _dense("regressor", self._state, {"K": self._widened(self.dynamics.regressor())})

    def _widened(self, K: ca.SX) -> ca.SX:
        """K (n, p) with columns for the calibrator's bodies, which the free machine does not carry."""
        return ca.horzcat(K, ca.SX(K.size1(), len(self.parameters) - K.size2()))

    @cached_property
    def regressor_pattern(self) -> NDArray[np.bool_]:
        """Which entries (r, p) of the regressor are structurally nonzero, while a calibrator may be attached."""
        function = self.regressor if self.linear else self.linearised
        pattern = np.zeros(self.regressor.size_out(0), dtype=bool)
        pattern[*map(list, ca.sparsify(function.call(function.sx_in())[0]).sparsity().get_triplet())] = True
        pattern[:, len(self.dynamics.parameters):] = True
        return pattern

    @cached_property
    def inverse_dynamics(self) -> ca.Function:
        """(q, qd, qdd[, pressure], psi) → measured forces (r,) [N or N·m] (Eq. 4.56)."""
        return _dense("inverse_dynamics", self._state | self._psi, {"force": self.dynamics.forces(**self._psi)})

    @cached_property
    def efforts(self) -> ca.Function:
        """(q, qd, qdd[, pressure], psi) → generalised forces (n,) that a motion demands at the joints, and what each
        actuator (a,) takes for its own friction and offset."""
        torque, own = self.dynamics.efforts(**self._psi)
        return _dense("efforts", self._state | self._psi, {"torque": torque, "own": own})

    @cached_property
    def actuator_forces(self) -> ca.Function:
        """(q, qd, qdd[, pressure], load (n,), psi) → forces (a,) [N or N·m] of all actuators, measured or not, that
        carry a motion and a load at the joints; `shared_load` states how actuators of one joint share it."""
        load = {"load": ca.SX.sym("load", len(self.machine.joints))}
        return _dense("actuator_forces", self._state | load | self._psi,
                      {"force": self.dynamics.actuator_forces(**self._psi, **load)})

    @cached_property
    def passive_accelerations(self) -> ca.Function:
        """(q, qd, qdd, wrench (6,), load (n,), psi) → accelerations of the passive joints, for which nothing but the
        load acts there; those in `qdd` count as zero."""
        passive = [k for k, balance in enumerate(self.machine.balances) if not balance.actuators]
        joints, qdd = [self.dynamics.kept[k] for k in passive], self.coordinates.qdd
        given = self._motion | {"wrench": ca.SX.sym("wrench", 6),
                                "load": ca.SX.sym("load", len(self.machine.joints))} | self._psi
        balance = (self.dynamics.forces(given["psi"])
                   + self.dynamics.wrench_forces(given["wrench"]) + self.dynamics.at_balances(given["load"]))[passive]
        rest = ca.substitute(balance, qdd[joints], ca.DM.zeros(len(joints)))
        found = ca.solve(ca.jacobian(balance, qdd[joints]), -rest) if joints else ca.SX(0, 1)
        return _dense("passive_accelerations", given, {"accelerations": found})

    @cached_property
    def linearised(self) -> ca.Function:
        """(q, qd, qdd[, pressure], psi) → K (r, p), the derivative of the forces by ψ there, and the forces (r,)."""
        return _dense("linearised", self._state | self._psi, {
            "K": self._widened(self.dynamics.regressor(**self._psi)), "force": self.dynamics.forces(**self._psi)})

    @cached_property
    def force_by_motion(self) -> ca.Function:
        """(q, qd, qdd[, pressure], psi) → derivatives (r, n) of forces by q, qd, qdd; jumps of dry friction count as
        zero."""
        force = self.dynamics.forces(**self._psi)
        return _dense("force_by_motion", self._state | self._psi,
                      {f"by_{key}": ca.jacobian(force, x) for key, x in self._motion.items()})

    @cached_property
    def lagrange_forces(self) -> ca.Function:
        """(q, qd, qdd, psi) → the part of the measured forces due to bodies, from their energies."""
        total = ca.SX.zeros(len(self.machine.joints))
        for owner, places in self.dynamics.parameters.bodies.items():
            total += lagrange.joint_forces(self.dynamics, owner, self._psi["psi"][places])
        return _dense("lagrange_forces", self._motion | self._psi, {"force": self.dynamics.at_balances(total)})

    @cached_property
    def gravity_forces(self) -> ca.Function:
        """(q, psi) → measured forces (r, 3) per unit [m/s²] of gravity along each axis of the base frame."""
        moment = ca.SX.zeros(3)
        for owner, places in self.dynamics.parameters.bodies.items():
            phi, pose = self._psi["psi"][places], self.dynamics.body_motion(owner).pose
            moment += phi[0] * pose.origin + pose.rotation @ phi[1:4]
        force = self.dynamics.at_balances(-ca.jacobian(moment, self.coordinates.q).T)
        return _dense("gravity_forces", self._q | self._psi, {"force": force})

    @cached_property
    def gravity_regressor(self) -> ca.Function:
        """q → (3·r, p): derivatives of `gravity_forces` by ψ, those along x first, then y and z."""
        q, psi = self.coordinates.q, self._psi["psi"]
        return _dense("gravity_regressor", self._q, {"G": ca.jacobian(ca.vec(self.gravity_forces(q, psi)), psi)})

    @cached_property
    def tip_jacobian(self) -> ca.Function:
        """q (n,) → J (6, n): velocity x, y, z [m/s] and rate of rotation x, y, z [rad/s] of the tip, the far end of the
        machine's last link, in the base frame, per speed of each joint."""
        return _dense("tip_jacobian", self._q, {"J": self.dynamics.tip_jacobian})

    @cached_property
    def mass_matrix(self) -> ca.Function:
        """(q, psi) → M (n, n) at the joints [kg·m², kg·m, kg]: q̇ᵀ·M·q̇/2 is the kinetic energy of bodies and rotors."""
        return _dense("mass_matrix", self._q | self._psi, {"M": self.dynamics.mass_matrix(**self._psi)})

    @cached_property
    def gravity_torques(self) -> ca.Function:
        """(q, psi) → torques (n,) [N·m, N] at the joints that hold all bodies against gravity."""
        return _dense("gravity_torques", self._q | self._psi, {"torque": self.dynamics.gravity_torques(**self._psi)})

    @cached_property
    def wrench_forces(self) -> ca.Function:
        """(q, wrench (6,)) → what the wrench adds to the measured forces (r,) of `inverse_dynamics` [N or N·m].

        The wrench is what the surroundings exert on the machine at its tip: force x, y, z [N] and moment x, y, z about
        the tip [N·m], along the axes of the base frame. By virtual work it adds −Jᵀ·wrench at the joints.
        """
        wrench = ca.SX.sym("wrench", 6)
        return _dense("wrench_forces", self._q | {"wrench": wrench}, {"force": self.dynamics.wrench_forces(wrench)})

    @cached_property
    def tip_wrench(self) -> ca.Function:
        """(q, qd, qdd[, pressure], force, psi) → the wrench (6,) at the tip that explains measured forces, see
        `wrench_forces`, and how well the posture determines it, from 0 (not at all) to 1.

        Where the joints do not move the tip in all six ways it is the force alone, without a moment about the tip, and
        where they move it along a plane or a line only the part of the force along that. With more joints than unknowns
        squares of the joints' torques are least.
        """
        force = ca.SX.sym("force", len(self.machine.balances))
        missing = force - self.dynamics.forces(**self._psi)
        wrench, determined = self.dynamics.tip_wrench(self.dynamics.at_joints(missing))
        return _dense("tip_wrench", self._state | {"force": force} | self._psi,
                      {"wrench": wrench, "determined": determined})

    @cached_property
    def residual(self) -> ca.Function:
        """(q, qd, qdd[, pressure], force, psi) → measured minus predicted forces (r,)."""
        force = ca.SX.sym("force", len(self.machine.balances))
        predicted = self.inverse_dynamics(*self._state.values(), *self._psi.values())
        return _dense("residual", self._state | {"force": force} | self._psi, {"residual": force - predicted})

    @cached_property
    def residual_jacobian(self) -> ca.Function:
        """Jacobians of `residual` with respect to all of its inputs."""
        return self.residual.jacobian()

    @property
    def force_units(self) -> tuple[str, ...]:
        """Unit of each measured force."""
        return tuple(each.unit for each in self.machine.balances)

    @cached_property
    def shares(self) -> ca.Function:
        """q → shares (r, a): measured forces of the balances = shares · forces of the actuators; lever arms [m or 1]
        where several actuators are there to move a joint."""
        return _dense("shares", self._q, {"shares": self.dynamics.shares})

    @cached_property
    def transmission(self) -> ca.Function:
        """q → lever arms (a, n) of all actuators [m, m/rad or 1]: their speeds per speed of each joint."""
        return _dense("transmission", self._q, {"transmission": self.dynamics.transmission})

    @cached_property
    def force_from_pressure(self) -> Mapping[str, Mapping[str, float]]:
        """For every measured actuator the channels that its force is computed from, with factors [N/Pa, N·m/Pa or 1]
        (Eq. 4.33, 4.61)."""
        return {actuator.name: actuator.effort_factors for actuator in self.machine.measured_actuators}

    def over(self, function: ca.Function, *columns: Array, out: list[Array] | None = None) -> list[Array]:
        """Evaluate a function at N samples, see `Runner.over`."""
        return self._runner.over(function, *columns, out=out)


def _dense(name: str, inputs: Mapping[str, ca.SX], outputs: Mapping[str, ca.SX]) -> ca.Function:
    """A function with few operations and dense outputs, so that their layout is the same for every machine."""
    values = [ca.densify(value) for value in ca.cse([*outputs.values()])]
    return ca.Function(name, [*inputs.values()], values, [*inputs], [*outputs])


def _fitting(terms: Sequence[ForceTerm], machine: Machine) -> tuple[ForceTerm, ...]:
    """The terms, for measured actuators of a machine, with names of their own.

    Raises:
        ProblemError: an actuator is unknown or not measured, or a name is taken.
    """
    measured = [each.name for each in machine.measured_actuators]
    taken = set(dynamic_parameters.parameter_set(machine, calibrator=True).names)
    for term in terms:
        if not isinstance(term, ForceTerm):
            raise ProblemError(f"this is {type(term).__name__}, not a ForceTerm", where="Model",
                               remedy="give a list of hydroopt.ForceTerm")
        if term.actuator not in measured:
            raise ProblemError(f"'{term.actuator}' is not a measured actuator", where=term.where,
                               remedy=f"use {', '.join(measured)}")
        if both := taken & term.addresses.keys():
            raise ProblemError(f"{', '.join(sorted(both))} is a parameter already", where=term.where,
                               remedy="rename the coefficient")
        taken |= term.addresses.keys()
    return tuple(terms)


_recent = Recent[Model]()


def recent_model(machine: Machine, *, actuator_inertia: bool = True, calibrator: bool = False) -> Model:
    """The model of a machine: one that was made before where all that the machine file states is the same.

    Stating and simplifying the expressions takes longer than identification from a log of a minute.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> recent_model(load_machine("patu655_lift")) is recent_model(load_machine("patu655_lift"))
    True
    """
    return _recent.of((machine, machine.source, actuator_inertia, calibrator),
                      partial(Model, machine, actuator_inertia=actuator_inertia, calibrator=calibrator))


def model_of(given: Model | GivenMachine, where: str) -> Model:
    """A model, or that of a machine, name or file.

    Raises:
        ProblemError, MachineError: see `machine_of`.

    >>> model_of("patu655_lift", "test")
    Model('patu655_lift': 1 joint, 52 parameters, with actuator inertia)
    """
    return given if isinstance(given, Model) else recent_model(machine_of(given, where))
