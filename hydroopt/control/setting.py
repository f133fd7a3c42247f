"""The setting that all controllers share: machine, motion to follow and true parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from control import StateSpace

from hydroopt.control.feasibility import steady_speeds
from hydroopt.control.linear_plant import Point, linearised, point, sampled
from hydroopt.control.model_variants import ModelVariant
from hydroopt.control.reference import Demands, Reference
from hydroopt.control.tuning import COMPLEMENTARY_SENSITIVITY, SENSITIVITY
from hydroopt.control.valve_inversion import Valves
from hydroopt.errors import ProblemError
from hydroopt.model.hanging import Hanging
from hydroopt.model.plant import Plant
from hydroopt.model.workspace import SHARE, top_speed
from hydroopt.simulation.drive_valves import refuse_moving_base
from hydroopt.simulation.passive_joints import passive_motion
from hydroopt.simulation.simulate import Trajectory, sampling_rate
from hydroopt.spatial.evenly_spread import halton
from hydroopt.spatial.inertia import Array

MOTION_POINTS = 6
"""Points of the motion at which loops are analysed, and about which the LQG controller is designed."""
WORKSPACE_POINTS = 16
"""Postures over the joints' ranges at which loops are analysed as well."""
EDGE = 0.05
"""Part of a joint's range at each end that is left out."""


@dataclass(frozen=True, eq=False)
class Setting:
    """A machine, a motion to follow and its true parameters.

    Attributes:
        plant: the machine as its controllers know it.
        motion: to follow.
        true: the machine's true model and dynamic parameters; its geometry and delays may differ from the plant's.
        true_theta: its hydraulic parameters.
        theta: hydraulic parameters that all controllers use.
        rate: of the controller [Hz].
        seed: of the sensors' errors; None for none.
        sensitivity: largest sensitivity for which gains are tuned.
        gain: factor on the tuned position gains.
        bias: by which the readings of the joints' angles are off (n,) [rad or m]; None for no bias.
    """

    plant: Plant
    motion: Trajectory
    true: ModelVariant
    true_theta: Array
    theta: Array
    rate: float
    seed: int | None = 0
    sensitivity: float = SENSITIVITY
    gain: float = 1.0
    bias: Array | None = None

    @property
    def complementary_sensitivity(self) -> float:
        """The largest complementary sensitivity for which gains are tuned."""
        return COMPLEMENTARY_SENSITIVITY

    @cached_property
    def t(self) -> Array:
        """Times (N,) of the samples."""
        start, end = self.motion.t[0], self.motion.t[-1]
        return np.asarray(start + np.arange(int((end - start) * self.rate * (1 + 1e-9)) + 1) / self.rate)

    @cached_property
    def reference(self) -> Reference:
        """The motion between its samples; passive joints swing as the machine file's parameters make them.

        Raises:
            ProblemError: the base moves, or a passive joint leaves its range.
        """
        model, motion = self.plant.model, self.motion
        refuse_moving_base(self.plant, motion, "--motion")
        q, qd, qdd = passive_motion(model, motion.t, (motion.q, motion.qd, motion.qdd), model.parameters.nominal,
                                    motion.wrench)
        return Reference(replace(motion, q=q, qd=qd, qdd=qdd))

    @cached_property
    def demands(self) -> Demands:
        """References of the motion."""
        return Demands(Valves(self.plant, self.theta), self.reference, self.t)

    @cached_property
    def true_plant(self) -> Plant:
        """The true machine."""
        return self.plant if self.true.model is self.plant.model else Plant(self.true.model)

    def points(self, plant: Plant, psi: Array, theta: Array) -> tuple[list[Point], list[Point]]:
        """Operating points of the motion and over the workspace, of a plant with parameters ψ and θ.

        Joints move at least at the part `SHARE` of their greatest speeds, see `steady_speeds`; passive ones hang.

        Raises:
            ProblemError: the supply cannot move the machine at a point of the motion.
        """
        machine = plant.machine
        hanging = Hanging(plant.model)
        least = SHARE * np.array([top_speed(plant, joint) if joint in plant.drivers else 0.0
                                  for joint in machine.joints])
        lower, upper = np.array([machine.link(joint).joint.range for joint in machine.joints]).T
        moments = self.t[0] + (np.arange(MOTION_POINTS) + 0.5) / MOTION_POINTS * (self.t[-1] - self.t[0])
        path = self.reference.at(moments)
        on_motion = []
        for t, q, qd in zip(moments, hanging.postures(path.q), np.where(least > 0, path.qd, 0.0), strict=True):
            speeds = steady_speeds(plant, q, qd, least)
            on_motion.append(point(plant, f"motion at {t:.1f} s", q, speeds, psi, theta))
        n, in_workspace = len(least), list[Point]()
        for k, share in enumerate(halton(2 * n, WORKSPACE_POINTS)):
            direction = np.where(share[n:] < 0.5, -1.0, 1.0)
            q = hanging.postures((lower + (upper - lower) * (EDGE + (1 - 2 * EDGE) * share[:n]))[None])[0]
            try:
                in_workspace.append(point(plant, f"workspace {k + 1}", q, direction * least, psi, theta))
            except ProblemError:  # the supply may be too weak for some postures
                continue
        return on_motion, in_workspace

    def plants(self, plant: Plant, points: Sequence[Point], psi: Array, theta: Array) -> list[StateSpace]:
        """A sampled plant with its valves' delays about each point."""
        return [sampled(linearised(plant, each, psi, theta), plant.delays, 1 / self.rate) for each in points]


def rate_of(plant: Plant, rate: float | None, motion: Trajectory) -> float:
    """Samples per second [Hz] of a controller: the given one, or the highest rate of a joint's sensor.

    Raises:
        ProblemError: at this rate the motion has no samples, or more than can be held in memory.
    """
    rate = sampling_rate(plant.machine) if rate is None else rate
    duration = float(motion.t[-1] - motion.t[0])
    if not (np.isfinite(rate) and rate > 0 and 10 <= duration * rate <= 1e6):
        raise ProblemError(f"a controller at {rate:g} Hz cannot follow a motion of {duration:g} s", where="--rate",
                           remedy="give a rate of some samples per second, such as 50 or 100 Hz")
    return rate
