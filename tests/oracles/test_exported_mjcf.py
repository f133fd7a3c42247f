"""Exported MJCF as MuJoCo compiles it: its forces are hydroopt's, and its own constraints hold where hydroopt's do."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from fixtures.closures import spherical, steering, telescope
from fixtures.loops import z_bar
from fixtures.mechanisms import with_all_bodies
from fixtures.tiers import ONE_OF_A_KIND, tiered
from hydroopt.errors import MachineError
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import bundled, load_machine
from hydroopt.machine.robot_formats.writing import robot_files
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import NAMES
from oracles.mujoco_loops import MujocoLoops, Pin
from oracles.subjects import balances, forces, relative_error, states

SAID = (*NAMES, "f_viscous", "tau_viscous", "rotor_inertia")
"""Ends of the names of parameters that the file states; dry friction is left out of what is compared."""
FIXTURES = {"telescope": telescope, "Z-bar": z_bar, "spherical": spherical, "steering": steering}


class Exported(MujocoLoops):
    """The oracle's way to forces through loops, on a model that the oracle did not build."""

    def __init__(self, machine: Machine, text: str) -> None:
        self.machine, self.model = machine, mujoco.MjModel.from_xml_string(text)
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self.data = mujoco.MjData(self.model)
        self.pins = [self._pin(k) for k in range(self.model.neq) if self._connects(k)]
        self.given = [self._dof(joint) for joint in machine.joints]
        self.free = [k for k in range(self.model.nv) if k not in self.given]
        driven = [self.model.jnt_dofadr[self.model.actuator(each.name).trnid[0]] for each in machine.actuators]
        self.actuated = np.eye(self.model.nv)[:, driven]

    def _connects(self, k: int) -> bool:
        wraps = self.model.wrap_type[self.model.tendon_adr] if self.model.ntendon else ()
        spatial = int(self.model.eq_type[k]) == mujoco.mjtEq.mjEQ_TENDON and int(
            wraps[self.model.eq_obj1id[k]]) == mujoco.mjtWrap.mjWRAP_SITE
        return int(self.model.eq_type[k]) == mujoco.mjtEq.mjEQ_CONNECT or spatial

    def _pin(self, k: int) -> Pin:
        model, length = self.model, None
        sites = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if int(model.eq_type[k]) == mujoco.mjtEq.mjEQ_TENDON:
            tendon = sites[0]
            length = model.tendon_length0[tendon] + model.eq_data[k, 0]
            sites = tuple(int(each) for each in model.wrap_objid[model.tendon_adr[tendon]:][:2])
        bodies = tuple(model.body(model.site_bodyid[site]).name for site in sites)
        return Pin(bodies, tuple(model.site_pos[site].copy() for site in sites), length)

    def violation(self) -> float:
        """How far MuJoCo's own equality constraints are from holding."""
        self.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        mujoco.mj_forward(self.model, self.data)
        equal = self.data.efc_type[:self.data.nefc] == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        found = float(np.max(np.abs(self.data.efc_pos[:self.data.nefc][equal]), initial=0.0))
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        return found


@pytest.mark.parametrize("name", tiered([*(name for name in bundled() if name != "panda_mukca"), *FIXTURES],
                                        lambda name: name in (*ONE_OF_A_KIND, "spherical")))
def test_forces_are_hydroopts(name: str) -> None:
    machine = with_all_bodies(FIXTURES[name]() if name in FIXTURES else load_machine(name))
    subject, exported = Model(machine), Exported(machine, robot_files(machine, "x.xml").files["x.xml"])
    psi = subject.parameters.nominal.copy()
    for k, parameter in enumerate(subject.parameters.names):
        psi[k] *= parameter.endswith(SAID)
    state = states(machine, np.random.default_rng(6), 6)
    expected = []
    for row in zip(*state, strict=True):
        torque, arms = exported.virtual_work(*row)
        expected.append(balances(machine, arms, torque))
        assert exported.violation() < 1e-9
    assert relative_error(forces(subject, state, psi), np.array(expected)) < 1e-9


@pytest.mark.parametrize("name", tiered(bundled(), lambda name: name in ONE_OF_A_KIND))
def test_the_key_frame_closes_all_loops(name: str) -> None:
    machine = load_machine(name)
    exported = Exported(machine, robot_files(machine, "x.xml").files["x.xml"])
    mujoco.mj_resetDataKeyframe(exported.model, exported.data, 0)
    assert exported.violation() < 1e-9


def test_a_body_that_cannot_exist_is_refused() -> None:
    machine = load_machine("ur10").with_values({"wrist_1.I_xx": 1e3})
    with pytest.raises(MachineError, match=r"the body of 'wrist_1': no body has the principal moments .*; correct it"):
        robot_files(machine, "x.xml")
