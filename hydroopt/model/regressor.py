"""Regressor: measured forces f = K(q, q̇, q̈)·ψ, linear in all parameters but Stribeck speeds (Eq. 4.14 to 4.56).

The thesis eliminates the pin forces of every cylinder by hand (Eq. 4.23 to 4.44). Projecting each body's wrench on the
motion that the joints allow removes them all at once, for any tree and any position of the pins, since pin forces do no
work. Friction opposes the motion here; Eqs. 4.32 and 4.51 as printed, taken together, make a piston's assist it.

Rows are the machine's balances (`hydroopt.machine.balances`): an actuator's force where a single one moves the joint,
as in the thesis, and otherwise the joint's own equation, from which unmeasured forces are eliminated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property

import casadi as ca
import numpy as np

from hydroopt.machine.actuators import Actuator, Cylinder, Drive, GasCylinder
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.model.cylinder_motion import CylinderMotion, cylinder_motion
from hydroopt.model.kinematics import Coordinates, Motion, gravity_in_base, link_motions
from hydroopt.model.load_sharing import shared_load
from hydroopt.model.mechanism import tree_motion
from hydroopt.model.own_forces import MotionSymbols, friction_terms, own_force
from hydroopt.parameters.dynamic import parameter_set
from hydroopt.parameters.force_terms import ForceTerm
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.spatial import inertia
from hydroopt.spatial.poses import Pose, skew

POSTURES = 20
"""Number of random postures that tell which wrenches a machine can measure."""
RANK = 1e-6
"""Singular value below which a direction is none, as a part of the greatest."""


def body_regressor(motion: Motion) -> ca.SX:
    """Matrix (6, 10) with force and moment about the origin of P = A·φ (Eq. 4.14)."""
    w, wd, a = motion.rotation, motion.rotation_rate, motion.acceleration
    force = ca.horzcat(a, motion.spread, ca.SX(3, 6))
    moment = ca.horzcat(ca.SX(3, 1), -skew(a), _bullet(wd) + skew(w) @ _bullet(w))
    return ca.vertcat(force, moment)


def _bullet(w: ca.SX) -> ca.SX:
    """[•ω] (3, 6) with I·ω = [•ω]·(I_xx, I_xy, I_xz, I_yy, I_yz, I_zz) (Eq. 4.12)."""
    x, y, z = w[0], w[1], w[2]
    return ca.blockcat([[x, y, z, 0, 0, 0], [0, x, 0, y, z, 0], [0, 0, x, 0, y, z]])


class Dynamics:
    """All expressions of a machine's dynamics in one set of symbols; `Model` turns them into functions."""

    def __init__(self, geometry: Geometry, coordinates: Coordinates, terms: Sequence[ForceTerm] = (), *,
                 actuator_inertia: bool = True) -> None:
        self.geometry, self.coordinates, self.terms = geometry, coordinates, tuple(terms)
        self.actuator_inertia = actuator_inertia
        self.machine: Machine = geometry.machine
        self.pressure = ca.SX.sym("pressure", len(self.machine.actuators))
        """Sum of the pressures [Pa] in both chambers of each cylinder, for the friction of seals and own terms."""
        self.tree = tree_motion(geometry, coordinates)
        links = link_motions(geometry, self.tree.symbols)
        cylinders = {c.name: cylinder_motion(geometry, c, links, self.tree.symbols) for c in self.machine.pinned}
        self.links: dict[str, Motion] = self.tree.closed(links)
        self.cylinders: dict[str, CylinderMotion] = self.tree.closed(cylinders)
        self.rates = ca.vertcat(*[self._rate_of(a) for a in self.machine.actuators])
        self.transmission = self._transmission()
        """(actuators, joints): actuator speed = transmission · q̇; its entries are the lever arms."""
        self.own_forces = tuple(own_force(term, k, self._symbols(k)) for term in self.terms
                                for k, each in enumerate(self.machine.actuators) if each.name == term.actuator)
        """Terms of the user's own."""

    def _symbols(self, k: int) -> MotionSymbols:
        actuator = self.machine.actuators[k]
        q, qd, qdd = (dict(zip(self.machine.joints, ca.vertsplit(x), strict=True)) for x in self.coordinates)
        position = (self.cylinders[actuator.name].length if isinstance(actuator, Cylinder)
                    else self.coordinates.q[self.joint_of(actuator)])
        return MotionSymbols(q, qd, qdd, position, self.rates[k], self.pressure[k])

    @cached_property
    def parameters(self) -> ParameterSet:
        """The parameters ψ of bodies, with barrels and rods or without, and of efforts."""
        return parameter_set(self.machine, actuator_inertia=self.actuator_inertia, terms=self.terms)

    def without_actuator_inertia(self) -> Dynamics:
        """The same expressions for the thesis's reduced model, without barrels and rods."""
        made = copy(self)
        made.actuator_inertia = False
        made.__dict__.pop("parameters", None)
        return made

    def _rate_of(self, actuator: Actuator) -> ca.SX:
        if isinstance(actuator, Cylinder):
            return self.cylinders[actuator.name].speed
        return self.coordinates.qd[self.joint_of(actuator)]

    def joint_of(self, actuator: Actuator) -> int:
        """Place in q of the joint that an actuator is there to move."""
        return self.machine.joints.index(self.machine.main_joint(actuator))

    def _transmission(self) -> ca.SX:
        full = ca.jacobian(self.rates, self.coordinates.qd)
        sparse = ca.SX(*full.shape)
        # joints that carry both ends of a cylinder do not change its length: the entry is zero, also symbolically
        for k, actuator in enumerate(self.machine.actuators):
            for joint in self.machine.moved_by(actuator):
                j = self.machine.joints.index(joint)
                sparse[k, j] = full[k, j]
        return sparse

    def body_motion(self, owner: str) -> Motion:
        """Motion of the frame of a link (``boom``), barrel or rod (``boom_cylinder.rod``)."""
        name, _, end = owner.partition(".")
        if not end:
            return self.links[name]
        return self.cylinders[name].barrel if end == "barrel" else self.cylinders[name].rod

    def _allowed(self, owner: str) -> ca.SX:
        motion = self.body_motion(owner)
        return ca.jacobian(ca.vertcat(motion.velocity, motion.rotation), self.coordinates.qd)

    @cached_property
    def work(self) -> ca.SX:
        """(n, n): generalised forces = work · x, with one entry of x for each joint; upper triangular but for joints
        that only several cylinders together move.

        It is the force of the one actuator that is there to move the joint; or of an unmeasured one that moves other
        joints too; else the generalised force at the joint itself.
        """
        machine, made = self.machine, ca.SX.eye(len(self.machine.joints))
        for j, (joint, drivers) in enumerate(machine.drivers.items()):
            if joint in machine.redundant:
                continue
            lost = [each for each in drivers if not each.measured and len(machine.moved_by(each)) > 1]
            for each in lost or (drivers if len(drivers) == 1 and drivers[0].measured else ()):
                made[:, j] = self.transmission[machine.actuators.index(each), :].T
        return made

    @cached_property
    def levers(self) -> list[ca.SX]:
        """Numbers [m or 1] of which none may vanish where `work` is solved: its diagonal, lever arms of actuators that
        are alone at a joint or eliminated; of joints that only several cylinders together move, for each joint how far
        its direction is from those of the ones before, from 0 to 1."""
        found: list[ca.SX] = ca.vertsplit(ca.diag(self.work))
        for group in self.machine.entangled:
            if group[0] in self.machine.redundant:
                continue
            places = [self.machine.joints.index(joint) for joint in group]
            ways = self.work[places, places].T
            _, pivots = ca.qr(ways)
            for k, j in enumerate(places):
                found[j] = pivots[k, k] / ca.norm_2(ways[:, k])
        return found

    def at_balances(self, generalised: ca.SX) -> ca.SX:
        """What the balances measure (r, ·) where generalised forces (n, ·) act, without those that they eliminate."""
        work = self.work
        diagonal = work.sparsity().is_diag()
        found = ca.diag(1 / ca.diag(work)) @ generalised if diagonal else ca.solve(work, generalised)
        return found if len(self.kept) == work.size1() else found[self.kept, :]

    @cached_property
    def kept(self) -> list[int]:
        """Places in q of the joints of the balances."""
        return [self.machine.joints.index(each.joint) for each in self.machine.balances]

    @cached_property
    def shares(self) -> ca.SX:
        """(r, actuators): measured forces of the balances = shares · forces of the actuators; zero for those that are
        not measured."""
        machine = self.machine
        made = ca.SX(len(machine.balances), len(machine.actuators))
        alone = {each.alone.name: k for k, each in enumerate(machine.balances) if each.alone}
        for each in machine.measured_actuators:
            i = machine.actuators.index(each)
            if each.name in alone:
                made[alone[each.name], i] = 1
            else:
                made[:, i] = self.at_balances(self.transmission[i, :].T)
        return made

    def at_joints(self, measured: ca.SX) -> ca.SX:
        """Generalised forces (r, ·) at the joints of the balances, where these measure (r, ·)."""
        return self.work[self.kept, self.kept] @ measured

    def projected(self, generalised: ca.SX) -> ca.SX:
        """Generalised forces (n, ·) as those at the joints of the balances (r, ·) that these measure alike."""
        if len(self.kept) == generalised.size1():
            return generalised
        return self.at_joints(self.at_balances(generalised))

    @cached_property
    def tip(self) -> Pose:
        """The far end of the machine's last link, in the base frame."""
        name = self.machine.tip
        return self.links[name].pose @ self.geometry.far_end(name)

    @cached_property
    def tip_jacobian(self) -> ca.SX:
        """(6, n): velocity and rate of rotation of the tip in the base frame = this · q̇."""
        name = self.machine.tip
        end = self.links[name].fixed(self.geometry.far_end(name))
        turn = end.pose.rotation
        return ca.jacobian(ca.vertcat(turn @ end.velocity, turn @ end.rotation), self.coordinates.qd)

    def mass_matrix(self, psi: ca.SX) -> ca.SX:
        """M (n, n) of the kinetic energy q̇ᵀ·M·q̇/2 of all bodies and rotors."""
        total = ca.SX.zeros(len(self.machine.joints), len(self.machine.joints))
        for owner, places in self.parameters.bodies.items():
            phi, allowed = psi[places], self._allowed(owner)
            xx, xy, xz, yy, yz, zz = ca.vertsplit(phi[4:])
            about = ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            moment = skew(phi[1:4])
            total += allowed.T @ ca.blockcat([[phi[0] * ca.SX.eye(3), -moment], [moment, about]]) @ allowed
        for drive in self.machine.drives:
            place = self.parameters.positions.get(f"{drive.name}.rotor_inertia")
            if place is not None:
                joint = self.joint_of(drive)
                total[joint, joint] += drive.gear**2 * psi[place]
        return total

    def gravity_torques(self, psi: ca.SX, gravity: ca.SX | None = None) -> ca.SX:
        """Generalised forces (n,) that hold all bodies against gravity (3,) in the base frame, the machine file's if it
        is not given."""
        acceleration = gravity_in_base(self.machine) if gravity is None else gravity
        total = ca.SX.zeros(len(self.machine.joints))
        for owner, places in self.parameters.bodies.items():
            phi = psi[places]
            up = -self.body_motion(owner).pose.rotation.T @ acceleration
            total += self._allowed(owner).T @ ca.vertcat(phi[0] * up, ca.cross(phi[1:4], up))
        return total

    def wrench_forces(self, wrench: ca.SX) -> ca.SX:
        """What a wrench (6,) that acts on the machine at the tip adds to the measured forces (r,): −Jᵀ·wrench at the
        joints, by virtual work."""
        return self.at_balances(-self.tip_jacobian.T @ wrench)

    @cached_property
    def wrench_rank(self) -> tuple[int, int]:
        """How many numbers of a wrench at the tip count as unknown, 6 or 3, and how many of these the measured forces
        determine in a general posture of the machine as its file states it."""
        jacobian, stated = self.projected(self.tip_jacobian.T).T, self.geometry.numbers
        symbols = ca.vertcat(*(self.geometry.value[each.name] for each in stated))
        at = ca.substitute(jacobian, symbols[free := [k for k in range(len(stated)) if not symbols[k].is_constant()]],
                           ca.DM([stated[k].value for k in free])) if stated else jacobian
        function = ca.Function("jacobian", [self.coordinates.q], [at])
        lower, upper = self.machine.ranges.T
        found = [np.array(function(q)) for q in np.random.default_rng(0).uniform(lower, upper, (POSTURES, len(lower)))]

        def rank(rows: int) -> int:
            return max((int(np.linalg.matrix_rank(J[:rows], RANK * np.linalg.norm(J[:rows], 2))) for J in found
                        if np.all(np.isfinite(J))), default=0)

        return (6, 6) if rank(6) == 6 else (3, rank(3))

    def tip_wrench(self, torque: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Wrench (6,) at the tip that `wrench_forces` says the actuators carry with `torque` (r,) of `at_joints`.

        Joints that move the tip in all six ways determine force and moment, others the force alone: the moment then
        counts as zero. Where they move it along a plane or a line only, they determine the force along that, and the
        rest of it counts as zero. With more joints than unknowns the squares of the joints' torques are least.

        Returns:
            The wrench, and a number in 0 … 1 which is 0 where the posture determines no wrench.
        """
        jacobian = self.projected(self.tip_jacobian.T).T
        moving = [k for k in range(jacobian.size2()) if jacobian[:, k].nnz()]
        rows, rank = self.wrench_rank
        J = ca.densify(jacobian[:rows, moving])
        if rank < min(rows, len(moving)):
            force, plane = _along(J, torque[moving], rank)
            return ca.vertcat(-force, ca.SX.zeros(3)), plane
        wide = len(moving) >= rows
        columns = J.T if wide else J
        Q, R = ca.qr(columns)  # equations for the least squares would square their condition
        least = ca.sign(R[0, 0])
        for k in range(1, R.size1()):
            least = least * R[k, k] ** 2 / ca.sumsqr(columns[:, k])
        found = ca.solve(R, Q.T @ torque[moving]) if wide else Q @ ca.solve(R.T, torque[moving])
        # where a column depends on those before it, those after it are no numbers
        return ca.vertcat(-found, ca.SX.zeros(6 - rows)), ca.fmax(least, 0.0)

    def regressor(self, psi: ca.SX | None = None) -> ca.SX:
        """K (r, p): measured forces of the balances = K·ψ, columns in the order of `parameter_set` (Eq. 4.55).

        Of forces that are not linear in the parameters K is the derivative at `psi` (p,), or at the nominal values,
        where a Stribeck force of zero counts as its typical size: it would hide its speed.
        """
        if psi is None:
            psi = ca.DM(np.where(self.parameters.nominal == 0, self.parameters.scale, self.parameters.nominal))
        columns: dict[str, ca.SX] = {}
        for owner in self.parameters.bodies:
            # six columns are fewer than ten
            block = self.at_balances(self._allowed(owner).T) @ body_regressor(self.body_motion(owner))
            columns |= {f"{owner}.{element}": block[:, k] for k, element in enumerate(inertia.NAMES)}
        columns |= self._effort_columns(psi)
        return ca.horzcat(*[columns[name] for name in self.parameters.names])

    def forces(self, psi: ca.SX) -> ca.SX:
        """K·ψ (r,) in fewer operations: each body's wrench is computed before it is projected on the joints."""
        total = self.at_balances(self._of_bodies(psi))
        for each in self.own_forces:
            total = total + self.shares[:, each.actuator] * each.at(self.parameters, psi)[0]
        return self._added(total, psi, self._effort_columns(psi))

    def actuator_forces(self, psi: ca.SX, load: ca.SX | None = None) -> ca.SX:
        """Forces (a,) of all actuators, measured or not, that a motion demands, see `shared_load`.

        They carry bodies, friction at joints and pins, gas, and a `load` (n,) of generalised forces; each has its own
        friction and offset besides.
        """
        total, own = self.efforts(psi)
        return shared_load(self.machine, self.transmission, total if load is None else total + load) + own

    def efforts(self, psi: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Generalised forces (n,) at the joints that a motion demands of the actuators, and what each (a,) takes for
        its own friction and offset."""
        total = self._of_bodies(psi)
        own = [self._added(ca.SX(0), psi, self._own_friction(k, psi))
               for k in range(len(self.machine.actuators))]
        for each in self.own_forces:
            own[each.actuator] = own[each.actuator] + each.at(self.parameters, psi)[0]
        return self._added(total, psi, self._joint_columns()), ca.vertcat(*own)

    def _added(self, total: ca.SX, psi: ca.SX, columns: Mapping[str, ca.SX]) -> ca.SX:
        """A sum and columns times their parameters; a Stribeck speed acts in the column of its force already, and own
        terms are added as they are."""
        for name, column in columns.items():
            place = self.parameters.positions.get(name)
            if place is not None and self.parameters.kinds[place] not in (
                    ParameterKind.STRIBECK_SPEED, ParameterKind.COEFFICIENT):
                total = total + column * psi[place]
        return total

    def _of_bodies(self, psi: ca.SX) -> ca.SX:
        total = ca.SX.zeros(len(self.machine.joints))
        for owner, places in self.parameters.bodies.items():
            total += self._allowed(owner).T @ (body_regressor(self.body_motion(owner)) @ psi[places])
        return total

    def _own_friction(self, k: int, psi: ca.SX) -> dict[str, ca.SX]:
        """Terms of an actuator's own force, by parameter."""
        return friction_terms(self.machine.actuators[k], self.rates[k], self.pressure[k],
                              lambda name: psi[self.parameters.index(name)])

    def _effort_columns(self, psi: ca.SX) -> dict[str, ca.SX]:
        """Columns (r,) of everything but bodies."""
        columns = {name: self.at_balances(column) for name, column in self._at_joints().items()}
        for k, actuator in enumerate(self.machine.actuators):
            share = self.shares[:, k]
            columns |= {name: share * term if share.nnz() else share
                        for name, term in self._own_friction(k, psi).items()}
            columns |= {name: self.at_balances(column) for name, column in self._of_actuator(actuator).items()}
        for each in self.own_forces:
            share = self.shares[:, each.actuator]
            columns |= {name: share * slope for name, slope in each.at(self.parameters, psi)[1].items()}
        return columns | {name: self.at_balances(column) for name, column in self._passive_columns().items()}

    def _joint_columns(self) -> dict[str, ca.SX]:
        """Generalised forces (n,) per parameter of friction at joints and pins, of rotors, gas and springs."""
        columns = self._at_joints()
        for actuator in self.machine.actuators:
            columns |= self._of_actuator(actuator)
        return columns | self._passive_columns()

    def _at_joints(self) -> dict[str, ca.SX]:
        """Generalised forces of friction and springs at the joints of the tree."""
        columns: dict[str, ca.SX] = {}
        values = self.tree.values
        for joint, at, turn in zip(self.machine.tree_joints, *map(ca.vertsplit, (values.q, values.qd)), strict=True):
            share = ca.jacobian(turn, self.coordinates.qd).T
            columns |= {f"{joint}.tau_coulomb": share * ca.sign(turn), f"{joint}.tau_viscous": share * turn}
            if (spring := self.machine.link(joint).joint.spring) is not None:
                columns |= {f"{joint}.stiffness": share * (at - spring.reference), f"{joint}.preload": share}
        return columns

    def _of_actuator(self, actuator: Actuator) -> dict[str, ca.SX]:
        """Generalised forces of the friction of its pins, and of its rotor."""
        qd, qdd = self.coordinates.qd, self.coordinates.qdd
        if isinstance(actuator, Cylinder):
            motion = self.cylinders[actuator.name]
            return {f"{actuator.name}.{pin}": ca.jacobian(turn, qd).T * ca.sign(turn)
                    for pin, turn in (("n_barrel", motion.barrel_turn), ("n_rod", motion.rod_turn))}
        if isinstance(actuator, Drive):
            at = self.joint_of(actuator)
            return {f"{actuator.name}.rotor_inertia": ca.SX.eye(qd.size1())[:, at] * actuator.gear**2 * qdd[at]}
        return {}

    def _passive_columns(self) -> dict[str, ca.SX]:
        """Generalised forces of gas cylinders and springs."""
        columns: dict[str, ca.SX] = {}
        for gas in self.machine.gas_cylinders:
            motion = self.cylinders[gas.name]
            # the force of the gas relieves the actuators and enters with a minus sign
            columns[f"{gas.name}.precharge"] = -(ca.jacobian(motion.speed, self.coordinates.qd).T
                                                 * gas_force(gas, motion.length))
        for spring in self.machine.springs:
            motion = self.cylinders[spring.name]
            share = ca.jacobian(motion.speed, self.coordinates.qd).T
            columns |= {f"{spring.name}.stiffness": share * (motion.length - spring.reference_length),
                        f"{spring.name}.preload": share}
        return columns


def _along(J: ca.SX, torque: ca.SX, rank: int) -> tuple[ca.SX, ca.SX]:
    """Force (3,) with least squares of what Jᵀ·force leaves of `torque`, where J (3, n) has rank 2 or less: the
    pseudo-inverse in closed form; and how evenly the plane determines it, from 0 to 1."""
    gram, right = J @ J.T, J @ torque
    trace = ca.trace(gram)
    if rank == 0:
        return ca.SX.zeros(3), ca.SX(0)
    if rank == 1:
        return right / trace, ca.SX(1)
    area = sum((gram[i, i] * gram[k, k] - gram[i, k]**2 for i, k in ((0, 1), (1, 2), (2, 0))), ca.SX(0))
    return (trace * right - gram @ right) / area, ca.fmax(4 * area / trace**2, 0.0)


def gas_force(gas: GasCylinder, length: ca.SX) -> ca.SX:
    """Force along the lengthening of the cylinder per unit of precharge pressure [m²], from p·Vⁿ = const.

    The pressure is taken as given, see `GasCylinder`: ambient pressure on the other side is neglected.
    """
    sign = 1 if gas.acts == "push" else -1
    return sign * gas.area * (gas.volume / gas.gas_volume(length)) ** gas.polytropic
