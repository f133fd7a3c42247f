"""The calibrator attached between a machine and a fixture: what its bodies add to the actuator forces.

The calibrator's joints have no actuators. With the joints of machine and calibrator (q_a, q_c) and the closed loop
c(q_a, q_c) = 0, virtual displacements satisfy C_a·δq_a + C_c·δq_c = 0, so that δq_c = G·δq_a with G = −C_c⁺·C_a, and
by virtual work the joints of the machine carry τ_a,bodies + Gᵀ·τ_c,bodies: forces at pins and fixture do no work. The
bodies' forces τ are those of Newton and Euler along the whole chain (Eq. 4.14), for the motion q̇_c, q̈_c that the loop
and its derivatives C·q̇ = 0, C·q̈ + Ċ·q̇ = 0 allow. Where the calibrator has more freedoms than the loop holds, its own
equations of motion make the choice of G among all that satisfy the loop immaterial.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.machine.calibration_chain import Fixture
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.kinematics import Coordinates, link_motions
from hydroopt.model.mechanism import tree_motion
from hydroopt.model.model import Model
from hydroopt.model.regressor import body_regressor
from hydroopt.spatial.inertia import Array

OPEN = 1e-6
"""Part of a joint's motion of the tip that the calibrator may be unable to follow, from rounding."""


class AttachedCalibrator:
    """A machine whose calibrator stands in a fixture; n joints of the machine, r of the calibrator.

    Attributes:
        model: the machine with the calibrator's bodies among its parameters.
        fixture: what holds the calibrator's tip.
        kinematics: the closed chain; its joints are the machine's, then the calibrator's.
        loop_rates: casadi.Function (q, qd) -> C (k, n + r) and Ċ·q̇ (k,) of the loop, in the directions that the
            fixture holds.
        generalised: (q, qd, qdd) -> forces (n + r, 10·bodies) of the calibrator's bodies along all joints, a column a
            parameter.

    Raises:
        ProblemError: no body of the calibrator is a parameter of the model.

    >>> import hydroopt as ho
    >>> data = ho.load_machine("cat215b").model_dump()
    >>> data["calibrator"]["links"][-1]["body"] = {"m": 40, "com": (1, 0, 0), "inertia_com": (1, 0, 0, 9, 0, 9)}
    >>> machine = ho.Machine.model_validate(data)
    >>> attached = AttachedCalibrator(Model(machine, calibrator=True), machine.fixtures[0])
    >>> attached.owners, attached.joints
    (('forearm',), ('grapple_swing', 'grapple', 'yoke', 'upper_arm', 'forearm'))
    """

    def __init__(self, model: Model, fixture: Fixture) -> None:
        machine, own = model.machine, model.machine.calibrator
        self.model, self.fixture = model, fixture
        self.owners = tuple(link.name for link in (own.links if own else ()) if link.name in model.parameters.bodies)
        if not self.owners:
            raise ProblemError("no body of the calibrator is a parameter", where=machine.name,
                               remedy="state the bodies of its links, and use Model(machine, calibrator=True)")
        self.kinematics = chain = KinematicModel(machine)
        count = len(chain.joints)
        symbols = Coordinates(*(ca.SX.sym(name, count) for name in ("q", "qd", "qdd")))
        place = ca.DM(chain.place_of(fixture, 1)[0])
        loop = chain.loop(ca.DM(chain.parameters.nominal), symbols.q, place)[list(fixture.closes)]
        rate = ca.jtimes(loop, symbols.q, symbols.qd)
        self.loop_rates = ca.Function(
            "loop_rates", [symbols.q, symbols.qd],
            [ca.densify(ca.jacobian(loop, symbols.q)), ca.densify(ca.jtimes(rate, symbols.q, symbols.qd))],
            ["q", "qd"], ["C", "curvature"])
        n = len(machine.joints)
        tree = tree_motion(model.geometry, Coordinates(*(column[:n] for column in symbols)))
        whole = Coordinates(*(ca.vertcat(own, column[n:]) for own, column in zip(tree.symbols, symbols, strict=True)))
        motions = tree.closed(link_motions(model.geometry, whole, model.geometry.links))
        columns = []
        for owner in self.owners:
            motion = motions[owner]
            allowed = ca.jacobian(ca.vertcat(motion.velocity, motion.rotation), symbols.qd)
            columns.append(allowed.T @ body_regressor(motion))
        self.generalised = ca.Function("generalised", [*symbols], [ca.densify(ca.horzcat(*columns))],
                                       ["q", "qd", "qdd"], ["force"])
        self._at_balances = ca.Function("at_balances", [model.coordinates.q],
                                        [ca.densify(model.dynamics.at_balances(ca.SX.eye(n)))])

    @property
    def joints(self) -> tuple[str, ...]:
        """The calibrator's joints (c,)."""
        return self.kinematics.joints[len(self.model.machine.joints):]

    def regressor(self, q: Array, qd: Array, qdd: Array) -> Array:
        """What the calibrator adds to the model's regressor K (N, r, p), for a motion (N, n + c) on the closed loop.

        Raises:
            ProblemError: see `at_joints`.
        """
        n = len(self.model.machine.joints)
        return np.asarray(self.kinematics.over(self._at_balances, q[:, :n])[0] @ self.at_joints(q, qd, qdd))

    def at_joints(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Generalised forces (N, n, p) per parameter that the calibrator loads the machine's joints with.

        Raises:
            ProblemError: the calibrator cannot follow all motions of the machine, so that forces between the two
                depend on how stiff they are.
        """
        n, parameters, over = len(self.model.machine.joints), self.model.parameters, self.kinematics.over
        C = over(self.loop_rates, q, qd)[0]
        G = -np.linalg.pinv(C[:, :, n:], rcond=OPEN) @ C[:, :, :n]
        missed = np.linalg.norm(C[:, :, :n] + C[:, :, n:] @ G, axis=1)
        held = np.max(missed / np.maximum(np.linalg.norm(C[:, :, :n], axis=1), 1e-9), axis=0) > OPEN
        if np.any(held):
            names = [self.model.machine.joints[k] for k in np.flatnonzero(held)]
            raise ProblemError(f"the calibrator in '{self.fixture.name}' cannot follow every motion of "
                               f"{', '.join(names)}, and the forces that hold it back are not known",
                               where=self.model.machine.name, remedy="give the calibrator the joints it needs")
        generalised = over(self.generalised, q, qd, qdd)[0]
        at_joints = generalised[:, :n] + np.swapaxes(G, 1, 2) @ generalised[:, n:]
        made = np.zeros((len(q), n, len(parameters)))
        places = np.concatenate([np.arange(len(parameters))[parameters.bodies[owner]] for owner in self.owners])
        made[:, :, places] = at_joints
        return made
