"""The machine of the simulations of Section 3.7: sweeps of one joint a stage, while locked joints creep."""

import math

import numpy as np

from hydroopt import calibration_problem, load_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from studies import closed_postures

POSES = 120
SWEEPS = {"stick_moves": (60, 115), "boom_moves": (-48, -8), "swing_moves": (-30, 30)}
"""Ranges [deg], assumed: Figures 16 to 18 are missing from the source."""
DRIFT = {"swing": 0.0, "boom": -0.3, "stick": 0.3}
"""Creep [deg] of a locked joint during a stage, assumed like the ranges."""
CREEP = {"none": lambda s: 0 * s, "even": lambda s: s, "settling": lambda s: (1 - np.exp(-4 * s)) / (1 - math.exp(-4)),
         "slip": lambda s: 1 / (1 + np.exp(-60 * (s - 0.5)))}
"""Part of a stage's creep by part of its time: a leak at constant load, oil that settles, a valve that slips once. The
method's own drift is even."""


def paths() -> dict:
    """Angles [rad] of the moving joint of each stage: out and back, twice."""
    return {stage: np.radians((low + high) / 2 + (high - low) / 2 * np.sin(np.linspace(0, 4 * np.pi, POSES)))
            for stage, (low, high) in SWEEPS.items()}


class Machine:
    """The nominal machine, its thesis-like sweeps, and what is held: cylinder pins and the ball's free direction."""

    def __init__(self, creep: str = "none", accuracy: float = 0.1) -> None:
        self.machine = with_resolvers(with_drift(load_machine("cat215b"), 0.0), accuracy)
        self.model = KinematicModel(self.machine)
        self.geometry = self.model.parameters.nominal
        self.fixture = np.array(self.machine.fixtures[0].position)
        self.stages = {stage.name: stage for stage in self.machine.stages}
        self.crept: dict[str, float] = {}
        self.q = np.concatenate([self.swept(name, path, creep) for name, path in paths().items()])
        self.labels = [name for name in paths() for _ in range(POSES)]

    def swept(self, name, path, creep) -> np.ndarray:
        """Closed postures of a stage."""
        stage = self.stages[name]
        q = closed_postures.sweep(self.model, stage, path[:, None], geometry=self.geometry, fixture=self.fixture)
        if creep != "none":
            q = q.copy()
            for locked in stage.locked.keys() & DRIFT.keys():  # it goes on from where it was, until the joint moves
                before = self.crept.get(locked, 0.0)
                turned = before + DRIFT[locked] * CREEP[creep](np.linspace(0, 1, len(q)))
                q[:, self.model.joints.index(locked)] += np.radians(turned)
                self.crept[locked] = turned[-1]
            for moved in stage.moves:
                self.crept.pop(moved, None)
            free = postures.sensed_joints(self.model)
            q, closed = postures.close(self.model, self.geometry, q, free, self.fixture)
            assert closed.all()
        return q

    def poses(self, seed):
        """What the calibrator's sensors read."""
        return postures.record(self.model, self.q, self.labels, ["ball"] * len(self.q), geometry=self.geometry,
                               seed=seed)

    def problem(self, poses, machine=None, *, priors=False):
        """Their calibration; without priors, so that nothing but the data counts."""
        problem = calibration_problem(machine or self.machine, poses, priors=priors, fixed={"ball.y": 0.0})
        pins = {name: problem.parameters.nominal[k] for k, name in enumerate(problem.parameters.names)
                if "cylinder" in name}
        return problem.fixing(**pins)


def with_drift(machine, degrees):
    """The machine file with a drift of locked joints as a nuisance."""
    stages = tuple(stage.model_copy(update={"drift": math.radians(degrees)}) for stage in machine.stages)
    return machine.model_copy(update={"stages": stages})


def with_resolvers(machine, accuracy):
    """The machine with the calibrator's resolvers to ±accuracy [deg]."""
    sensors = tuple(sensor.model_copy(update={"accuracy": math.radians(accuracy)})
                    if sensor.channels[0] == "grapple.q" else sensor for sensor in machine.sensors)
    return machine.model_copy(update={"sensors": sensors})


def misjudged(machine, seed):
    """The machine as known beforehand: every number with a sigma is off by as much at random; never the truth."""
    rng, known = np.random.default_rng(seed), KinematicModel(machine).parameters
    off = {name: float(value + sigma * rng.standard_normal()) for name, value, sigma in zip(
        known.names, known.nominal, known.scale, strict=True) if "cylinder" not in name}
    return machine.with_values(off | {"ball.x": 2.160 + 0.1 * float(rng.standard_normal()),
                                      "ball.z": -0.840 + 0.1 * float(rng.standard_normal())})
