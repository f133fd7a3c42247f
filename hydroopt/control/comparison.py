"""Which controller follows a motion best: all candidates on the same machine, with the same errors of the sensors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import control
import numpy as np
from scipy.stats import qmc

from hydroopt.control.cascade import Cascade, Gains
from hydroopt.control.closed_loop import Run, simulate
from hydroopt.control.feasibility import refuse_flow, refuse_opening, refuse_unstable, steady_speeds
from hydroopt.control.lqg import Lqg, design, reading_noise
from hydroopt.control.model_variants import COMPLETE, TRUE, Knowledge
from hydroopt.control.reference import Demands, Reference
from hydroopt.control.sampled import Linear, Margin, Point, linearised, margins, point, sampled
from hydroopt.control.tuning import SENSITIVITY, tuned
from hydroopt.control.valve_inversion import Valves
from hydroopt.errors import ProblemError
from hydroopt.model.plant import Plant
from hydroopt.model.workspace import SHARE, Sweep, top_speed, workspace_sweeps
from hydroopt.simulation.simulate import Trajectory, sampling_rate
from hydroopt.spatial.inertia import Array

PI, FEEDFORWARD, LQG = "pi", "feedforward", "lqg"
ON_THE_WAY = 6
"""Points of the motion at which loops are looked at, and about which the LQG controller is designed."""
WORKSPACE = 16
"""Postures all over the joints' ranges at which they are, too."""
EDGE = 0.05
"""Part of a joint's range at each end that is left out."""


class Bode(NamedTuple):
    """L(jω) (n, ω) of all loops at a point, with its name and frequencies [rad/s]."""

    point: str
    omega: Array
    loops: Array


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one controller made of the motion.

    Attributes:
        name: ``feedforward complete``.
        kind: `PI`, `FEEDFORWARD` or `LQG`.
        knowledge: the parameters it was given.
        run: what the machine did.
        error: of the joints (N, n) [rad or m].
        tip: distance (N,) [m] of the last link's far end from where it should be.
        margins: of all loops at all points.
        bode: of its loops at the point where one comes nearest to −1.
    """

    name: str
    kind: str
    knowledge: Knowledge
    run: Run
    error: Array
    tip: Array
    margins: tuple[Margin, ...]
    bode: Bode

    @property
    def tip_rms(self) -> float:
        """Root mean square [m] of the distance of the tip; infinite if the machine hit its stops."""
        return float(np.sqrt(np.mean(self.tip**2))) if not self.run.stopped else np.inf

    def worst(self, loop: str, key: str, points: Sequence[str] = ()) -> Margin:
        """The margin of a loop that is least by gain or phase, over some points or all."""
        own = [margin for margin in self.margins if margin.loop == loop and (not points or margin.point in points)]
        return min(own, key=lambda margin: float(getattr(margin, key)))


@dataclass(frozen=True, eq=False)
class Setting:
    """A machine, a motion to follow and what is true.

    Attributes:
        plant: the machine.
        motion: to follow.
        true: what the machine really is.
        true_theta: its hydraulic parameters.
        theta: those that all controllers are given.
        rate: of the controller [Hz].
        seed: of the sensors' errors; None for none.
        sensitivity: to which gains are tuned.
        gain: by which the tuned position gains are multiplied.
    """

    plant: Plant
    motion: Trajectory
    true: Knowledge
    true_theta: Array
    theta: Array
    rate: float
    seed: int | None = 0
    sensitivity: float = SENSITIVITY
    gain: float = 1.0

    @cached_property
    def t(self) -> Array:
        """Times (N,) of the samples."""
        start, end = self.motion.t[0], self.motion.t[-1]
        return np.asarray(start + np.arange(int((end - start) * self.rate * (1 + 1e-9)) + 1) / self.rate)

    @cached_property
    def reference(self) -> Reference:
        """The motion between its samples."""
        return Reference(self.motion)

    @cached_property
    def demands(self) -> Demands:
        """What it demands."""
        return Demands(Valves(self.plant, self.theta), self.reference, self.t)

    @cached_property
    def delays(self) -> Array:
        """Of the valves (n,) [s]."""
        return np.array([each.valve.delay for each in self.plant.actuators])

    def points(self, psi: Array, theta: Array) -> tuple[list[Point], list[Point]]:
        """Points of the motion, and all over the workspace, of a machine with parameters ψ and θ.

        Everywhere joints move at least at the part `SHARE` of their greatest speeds, see `steady_speeds`.

        Raises:
            ProblemError: the supply cannot move the machine at a point of the motion.
        """
        machine = self.plant.machine
        least = SHARE * np.array([top_speed(self.plant, joint) for joint in machine.joints])
        lower, upper = np.array([machine.link(joint).joint.range for joint in machine.joints]).T
        moments = self.t[0] + (np.arange(ON_THE_WAY) + 0.5) / ON_THE_WAY * (self.t[-1] - self.t[0])
        path = self.reference.at(moments)
        way = []
        for t, q, qd in zip(moments, path.q, path.qd, strict=True):
            speeds = steady_speeds(self.plant, q, qd, least)
            way.append(point(self.plant, f"motion at {t:.1f} s", q, speeds, psi, theta))
        n, space = len(least), list[Point]()
        for k, share in enumerate(qmc.Halton(2 * n, scramble=False).random(WORKSPACE + 1)[1:]):
            direction = np.where(share[n:] < 0.5, -1.0, 1.0)
            q = lower + (upper - lower) * (EDGE + (1 - 2 * EDGE) * share[:n])
            try:
                space.append(point(self.plant, f"workspace {k + 1}", q, direction * least, psi, theta))
            except ProblemError:  # the supply need not reach every posture
                continue
        return way, space

    def plants(self, points: Sequence[Point], psi: Array, theta: Array) -> list[control.StateSpace]:
        """The sampled plant with the valves' delays about each point."""
        return [sampled(linearised(self.plant, at, psi, theta), self.delays, 1 / self.rate) for at in points]


@dataclass(frozen=True, eq=False)
class Comparison:
    """All candidates on one motion.

    Attributes:
        setting: machine, motion and truth.
        gains: of the cascade.
        points: of the motion, then of the workspace, at which margins were taken.
        outcomes: in the order of the candidates.
        reference: joint positions (N, n) asked for.
    """

    setting: Setting
    gains: Gains
    points: tuple[Point, ...]
    outcomes: tuple[Outcome, ...]
    reference: Array

    @cached_property
    def sweeps(self) -> tuple[Sweep, ...]:
        """Frequency, damping and gain of every joint over the workspace, by the nominal parameters."""
        plant = self.setting.plant
        return workspace_sweeps(plant, plant.model.parameters.nominal, self.setting.theta)

    @property
    def winner(self) -> Outcome:
        """The least RMS error of the tip, of all that do not need the truth."""
        return min((o for o in self.outcomes if o.knowledge.name != TRUE), key=lambda o: o.tip_rms)

    @property
    def feedforward(self) -> Outcome | None:
        """The best of the feedforwards that do not need the truth."""
        own = [o for o in self.outcomes if o.kind == FEEDFORWARD and o.knowledge.name != TRUE]
        return min(own, key=lambda o: o.tip_rms, default=None)


def compare(setting: Setting, known: Sequence[Knowledge], kinds: Sequence[str] = (PI, FEEDFORWARD, LQG), *,
            say: Callable[[str], None] = lambda _: None) -> Comparison:
    """Let every candidate follow the motion.

    Gains are tuned once, by the parameters that count as complete, and are the same for PI and all feedforwards.

    Args:
        setting: machine, motion and truth.
        known: parameters to give to controllers, the complete ones among them; the true ones are added.
        kinds: of controllers.
        say: told what goes on.

    Raises:
        ProblemError: the motion asks for more than pump or valves give, or a loop is unstable on the way.
        SolverError: the plant could not be integrated.
    """
    best = next(each for each in known if each.name == COMPLETE)
    demands, period = setting.demands, 1 / setting.rate
    refuse_flow(setting.plant, setting.reference.at(setting.t))
    aim = demands.by(best.model, best.psi)
    refuse_opening(setting.plant, setting.t, aim, demands.valves)
    say("tuning")
    way, space = setting.points(best.psi, setting.theta)
    plants = setting.plants([*way, *space], best.psi, setting.theta)
    gains = tuned(plants, [*way, *space], demands.valves, setting.sensitivity)
    gains = replace(gains, position=setting.gain * gains.position)
    candidates: list[tuple[str, str, Knowledge, Cascade | Lqg]] = []
    if PI in kinds:
        still = demands.by(best.model, best.psi, gravity_only=True)
        candidates.append(("PI with gravity compensation", PI, best, Cascade(demands.valves, still, gains, period)))
    if FEEDFORWARD in kinds:
        candidates += [(f"feedforward {each.name}", FEEDFORWARD, each, Cascade(
            demands.valves, demands.by(each.model, each.psi), gains, period)) for each in (*known, setting.true)]
    if LQG in kinds:
        noise = reading_noise(setting.plant)
        designs = [design(plant, at, demands.valves, gains.position, noise)
                   for plant, at in zip(plants, way, strict=False)]
        nearest = np.minimum(np.arange(len(setting.t)) * len(way) // len(setting.t), len(way) - 1)
        candidates.append(("LQG", LQG, best, Lqg(demands.valves, aim, designs, nearest.tolist(), period)))
    way, space = setting.points(setting.true.psi, setting.true_theta)
    true_plants = setting.plants([*way, *space], setting.true.psi, setting.true_theta)
    path, outcomes = setting.reference.at(setting.t), []
    looked: dict[type, tuple[tuple[Margin, ...], Bode]] = {}  # all cascades have the same loops
    for name, kind, knowledge, controller in candidates:
        say(name)
        if type(controller) not in looked:
            looked[type(controller)] = _margins(true_plants, [*way, *space], controller, demands)
        found, bode = looked[type(controller)]
        refuse_unstable(name, [m for m in found if m.point in {at.name for at in way}])
        run = simulate(demands, controller, setting.true.psi, setting.true_theta, seed=setting.seed)
        wanted = path.q[:len(run.t)]
        away = np.linalg.norm(tip(setting.plant, run.q) - tip(setting.plant, wanted), axis=1)
        outcomes.append(Outcome(name, kind, knowledge, run, run.q - wanted, away, found, bode))
    return Comparison(setting, gains, (*way, *space), tuple(outcomes), path.q)


def tip(plant: Plant, q: Array) -> Array:
    """Where the last link's far end is (N, 3) [m]."""
    model = plant.model
    return np.asarray(model.over(model.forward_kinematics, q)[-1][:, :3, 3])


def _margins(plants: Sequence[control.StateSpace], points: Sequence[Point], controller: Linear,
             demands: Demands) -> tuple[tuple[Margin, ...], Bode]:
    names = [each.actuator.name for each in demands.plant.actuators]
    found: list[Margin] = []
    curves = []
    for plant, at in zip(plants, points, strict=True):
        here, omega, L = margins(plant, controller.linear(at), names, at.name)
        found += here
        curves.append((min(m.distance for m in here), Bode(at.name, omega, L)))
    return tuple(found), min(curves, key=lambda curve: curve[0])[1]


def rate_of(plant: Plant, rate: float | None, motion: Trajectory) -> float:
    """Samples per second [Hz] of a controller: what is asked for, or the highest rate of a joint's sensor.

    Raises:
        ProblemError: at this rate the motion has no samples, or more than can be held in memory.
    """
    rate = sampling_rate(plant.machine) if rate is None else rate
    duration = float(motion.t[-1] - motion.t[0])
    if not (np.isfinite(rate) and rate > 0 and 10 <= duration * rate <= 1e6):
        raise ProblemError(f"a controller at {rate:g} Hz cannot follow a motion of {duration:g} s", where="--rate",
                           remedy="give a rate of some samples per second, such as 50 or 100 Hz")
    return rate
