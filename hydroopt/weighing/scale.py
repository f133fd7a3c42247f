"""A scale: an identified machine with what is uncertain of it, and the load that it is to weigh."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from hydroopt.errors import ProblemError
from hydroopt.machine.machine import Machine
from hydroopt.model.carried_load import carried_load
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

STEEPEST = 0.5
"""Cosine of the angle from the machine file's gravity up to which a slope is taken."""


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Numbers (k,) with a mean (k,) and a covariance (k, k)."""

    mean: Array
    covariance: Array

    @classmethod
    def of_rows(cls, root: Array, right: Array) -> Gaussian:
        """The x with ``root·x − right`` independent and standard normal."""
        inverse = np.linalg.inv(root)
        return cls(np.asarray(np.linalg.solve(root, right)), inverse @ inverse.T)

    @property
    def rows(self) -> tuple[Array, Array]:
        """(root, right) of `of_rows`, with an upper triangular root (k, k)."""
        root = np.asarray(np.linalg.cholesky(np.linalg.inv(self.covariance))).T
        return root, root @ self.mean

    def __getitem__(self, places: slice) -> Gaussian:
        """Some of the numbers, whatever the others are."""
        return Gaussian(self.mean[places], self.covariance[places, places])

    def and_other(self, other: Gaussian) -> Gaussian:
        """These numbers, and after them others that are independent of them."""
        return Gaussian(np.concatenate([self.mean, other.mean]), block_diag(self.covariance, other.covariance))


@dataclass(frozen=True)
class CarriedLoad:
    """What a scale weighs, in the frame of the link that carries it.

    Attributes:
        link: the name of the link.
        centre: where the centre of mass is expected [m].
        centre_std: standard deviation of its place, each coordinate's or one for all [m].
        full_scale: the largest mass [kg].
        radius: of gyration about the expected centre, about [m].

    See `weigh` for an example.
    """

    link: str
    centre: tuple[float, float, float]
    centre_std: tuple[float, float, float]
    full_scale: float
    radius: float = 0.5

    def __post_init__(self) -> None:
        numbers = (*self.centre, *self.centre_std, self.full_scale, self.radius)
        if not np.all(np.isfinite(numbers)) or min(*self.centre_std, self.full_scale, self.radius) <= 0:
            raise ProblemError("a load needs finite numbers, and standard deviations, full scale and radius above 0",
                               where="load", remedy="state its centre in m, its sigma in m, the full scale in kg")


@dataclass(frozen=True)
class Uncertain:
    """Standard deviations of what no calibration tells.

    Attributes:
        slope: of the base's inclination, in each direction [rad].
        load_friction: of the friction that grows with the force, as a part of it.
        zero_drift: of each pressure's zero since the calibration [Pa].
        gain: of the relative error of force readings, the same in the calibration: of piston areas, torques per
            pressure and sensors' scales. Without a known load it is that of every mass. By default the machine file's
            ``[faults] gain``; if neither is stated, readings are taken as exact, but a known load determines their
            errors from `UNKNOWN_GAIN` on.

    Raises:
        ProblemError: the gain is negative, or not less than 1.

    See `weigh` for an example of a scale, which takes them as `uncertain`.
    """

    slope: float = float(np.radians(3.0))
    load_friction: float = 0.01
    zero_drift: float = 35e3
    gain: float | None = None

    def __post_init__(self) -> None:
        if self.gain is not None and not 0 <= self.gain < 1:
            raise ProblemError(f"a relative error must be at least 0 and less than 1, not {self.gain:g}", where="gain",
                               remedy="give a part of one, such as 0.02")


@dataclass(frozen=True, eq=False)
class ForceReadings:
    """What errors in scale of force readings, the same in the calibration and afterwards, have done to it.

    Attributes:
        taken: (p, r) what each force's readings contribute to the calibrated parameters.
        too_large: (r,) what calibration and known loads say about the part of each force that is read too much.
        std: of that part before the calibration.
    """

    taken: Array
    too_large: Gaussian
    std: float


@dataclass(frozen=True, eq=False)
class Scale:
    """An identified machine that weighs; `hydroopt.weighing.calibrated_scale.scale` makes one, `learned` refines it.

    Its own unknowns are, in this order: k numbers of the model, in directions that are independent and standard normal
    after the calibration; the friction of r balances per force; while it learns from a known load the part of each of
    the r forces that is read too much; two components of gravity [m/s²] across that of the machine file, along the
    base's x and y where z points up.

    Attributes:
        machine: as its file describes it.
        model: of the machine `with_offsets`.
        psi: (p,) identified parameters; offsets that the file does not state are zero.
        directions: (p, k) of what is uncertain of them.
        taken: (p, r) what the calibration took for parameters, per friction that grows with the force of each balance;
            while it learns from a known load, (p, 2·r), also per part of each force that is read too much.
        load: what it weighs.
        known: what is known of its own unknowns but gravity.
        uncertain: what no calibration tells.
        angle_std: (n,) noise of the joints' positions; force_std: (r,) of forces, as if it were white; inf of
            passive joints, whose balances do not weigh.
        tilt: roll and pitch of the base as stated, and their standard deviation [rad].
        gain: standard deviation of the relative error that all masses have in common.
        read: (r,) part of each force's readings that is taken off, as known loads tell it.
        known_loads: number of known loads that it has learned from.
        readings: what lets a known load determine errors in scale; None where they are stated to be exact.
        drifts: (k, a) part in the model's numbers of what drifts from session to session.

    See `weigh` for an example.
    """

    machine: Machine
    model: Model
    psi: Array
    directions: Array
    taken: Array
    load: CarriedLoad
    known: Gaussian
    uncertain: Uncertain
    angle_std: Array
    force_std: Array
    tilt: tuple[float, float, float]
    gain: float
    readings: ForceReadings | None
    drifts: Array
    read: Array
    known_loads: int = 0

    @cached_property
    def carried(self) -> Array:
        """(p, 10): what the load adds to ψ; its ten numbers stand about its expected centre."""
        return carried_load(self.model, self.load.link, self.load.centre)

    @cached_property
    def gravity(self) -> Array:
        """(3,) that of the machine file in the base frame [m/s²]."""
        return np.asarray(gravity_in_base(self.machine)).ravel()

    @cached_property
    def axes(self) -> Array:
        """(3, 3): unit vectors in the base frame, two across the machine file's gravity and one along it."""
        return axes_about(self.gravity)

    @cached_property
    def own(self) -> Gaussian:
        """What is known of all its own unknowns, with gravity on the slope as stated."""
        roll, pitch, std = self.tilt
        size = float(np.linalg.norm(self.gravity))
        return self.known.and_other(Gaussian(size * self._down(roll, pitch)[:2], (size * std) ** 2 * np.eye(2)))

    def _down(self, roll: float, pitch: float) -> Array:
        """(3,) gravity's direction by `axes` at a roll and a pitch of the base [rad]."""
        return self.axes @ [np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)]

    @property
    def gains(self) -> int:
        """Number of force readings whose error in scale is an own unknown: all or none."""
        return int(self.taken.shape[1]) - len(self.force_std)

    @property
    def exact(self) -> bool:
        """Whether force readings are taken to be right in scale."""
        return not self.known_loads and self.gain == 0

    def on_slope(self, roll: float, pitch: float, std: float | None = None) -> Scale:
        """The same scale on another slope: roll and pitch of the base [rad] as an inclinometer reads them.

        Friction and bodies stay as they were learned; what was learned of the former slope goes.

        Raises:
            ProblemError: gravity is nearly across that of the machine file.
        """
        if not self._down(roll, pitch)[2] > STEEPEST:
            raise ProblemError("this slope turns gravity more than 60 degrees from that of the machine file",
                               where="slope", remedy="give roll and pitch of the base as the file's orientation has "
                                                     "them, in rad")
        return replace(self, tilt=(roll, pitch, self.uncertain.slope if std is None else std))


def with_gains(scale: Scale) -> Scale:
    """The same scale with the errors in scale of force readings among its own unknowns, if there may be any."""
    if scale.readings is None:
        return scale
    wrong = scale.readings.taken
    return replace(scale, psi=scale.psi + wrong @ scale.read, read=np.zeros(len(scale.read)), gain=0.0,
                   known=scale.known.and_other(scale.readings.too_large), taken=np.hstack([scale.taken, wrong]))


def corrected(scale: Scale, known: Gaussian, weights: Array) -> Scale:
    """The scale after a known load: its readings are corrected, and what is left of their errors is that of masses.

    Were these errors unknowns beside a load that is weighed, samples linearised at different loads would seem to tell
    the ones from the other.

    Args:
        scale: with gains.
        known: of its own unknowns but gravity after the known load.
        weights: (r,) of the forces in a load's mass, which add up to 1.
    """
    if scale.readings is None:
        return replace(scale, known=known, known_loads=scale.known_loads + 1)
    r = len(scale.read)
    wrong = known[-r:]
    return replace(scale, psi=scale.psi - scale.readings.taken @ wrong.mean, read=wrong.mean, known=known[:-r],
                   taken=scale.taken[:, :r], gain=float(np.sqrt(weights @ wrong.covariance @ weights)),
                   known_loads=scale.known_loads + 1, readings=replace(scale.readings, too_large=wrong))


def in_another_session(scale: Scale) -> Scale:
    """The same scale after pressures' zeros have drifted anew; on the slope as stated."""
    kept = np.eye(len(scale.known.mean))
    kept[:len(scale.drifts), :len(scale.drifts)] -= scale.drifts @ scale.drifts.T
    return replace(scale, known=Gaussian(
        kept @ scale.known.mean, kept @ scale.known.covariance @ kept.T + np.eye(len(kept)) - kept @ kept))


def axes_about(gravity: Array) -> Array:
    """(3, 3): unit vectors, two across gravity (3,), near coordinate axes, and one along it."""
    down = gravity / np.linalg.norm(gravity)
    across = np.eye(3)[np.sort(np.argsort(np.abs(down), kind="stable")[:2])]
    first = across[0] - (across[0] @ down) * down
    first /= np.linalg.norm(first)
    second = across[1] - (across[1] @ down) * down - (across[1] @ first) * first
    return np.stack([first, second / np.linalg.norm(second), down])
