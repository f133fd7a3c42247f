"""Loops of a sampled controller: frequency responses, margins, damping ratios, poles, zeros and step responses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import control
import numpy as np
from control import StateSpace

from hydroopt.control.axes import Axes
from hydroopt.control.linear_plant import Point
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

FREQUENCIES = 150
"""Number of frequencies up to half the sampling rate at which loops are analysed, beside those about resonances."""
SLOWEST = 2e-4
"""The lowest of these frequencies, as a part of the sampling rate."""
LITTLE_DAMPING, WIDTHS = 0.1, np.tan(np.radians(np.arange(-85.0, 86.0, 10.0)))
"""Damping ratio below which a pole is a resonance, and frequencies about it in damping ratios from its own: equal steps
along the circle of its Nyquist curve."""
STANDING = 1e-4
"""Distance from 1 within which a pole is that of a position, which stands still where nothing moves it."""
INFINITE = 1e8
"""Size from which on a zero counts as one at infinity."""


class Margin(NamedTuple):
    """How far a loop is from instability.

    Attributes:
        point: name of the operating point.
        loop: the actuator at whose command the loop is cut, all others closed.
        gain: gain margin as a factor; infinite if there is none to reach, less than one where the loop is unstable.
        gain_at: its frequency [rad/s], where the phase crosses −180 degrees.
        phase: phase margin [rad]; infinite if the gain never reaches one.
        phase_at: its frequency [rad/s], where the gain crosses one.
        distance: smallest distance of the Nyquist curve from −1.
        damping: smallest damping ratio of the closed loop's poles; negative where it is unstable.
        damping_at: frequency of that pole [rad/s].
        undisturbed: smallest damping ratio of the plant's own poles, without any feedback.
        disk: disk margin α (Seiler, Packard and Gahinet 2020, balanced): gain may change by any factor between
            (2 − α)/(2 + α) and its inverse, and the phase at the same time within the same disk; 0 where any loop is
            unstable.
    """

    point: str
    loop: str
    gain: float
    gain_at: float
    phase: float
    phase_at: float
    distance: float
    damping: float
    damping_at: float
    undisturbed: float
    disk: float

    @property
    def growth(self) -> float:
        """Rate at which errors of an unstable loop grow [1/s]; zero where it is stable."""
        return max(-self.damping * self.damping_at, 0.0)

    def as_dict(self) -> dict[str, str | float | None]:
        """The entry of a table, in dB, degrees and Hz; None where a number does not exist."""
        return {"loop": self.loop, "point": self.point, "gain_margin_db": number(20 * np.log10(self.gain)),
                "gain_crossing_hz": number(self.gain_at / (2 * np.pi)),
                "phase_margin_deg": number(np.degrees(self.phase)),
                "phase_crossing_hz": number(self.phase_at / (2 * np.pi)), "sensitivity": number(1 / self.distance),
                "damping": self.damping, "damping_hz": number(self.damping_at / (2 * np.pi)),
                "damping_without_feedback": self.undisturbed, "disk_margin": number(self.disk)}


def frequencies(systems: Sequence[StateSpace]) -> Array:
    """Frequencies [rad/s] at which loops of sampled systems are analysed, up to half the sampling rate: in equal ratios
    and about the systems' resonances.

    The Nyquist curve runs through a circle within the width of a resonance, which equal ratios miss.
    """
    period = systems[0].dt
    found = [np.geomspace(2 * np.pi * SLOWEST, np.pi, FREQUENCIES) / period]
    for system in systems:
        size, damping, poles = _modes(system)
        damping = np.abs(damping)
        light = (damping < LITTLE_DAMPING) & (poles.imag > 0)
        found.append((size[light, None] * (1 + damping[light, None] * WIDTHS)).ravel())
    every = np.unique(np.concatenate(found))
    return np.asarray(every[(every >= found[0][0]) & (every <= found[0][-1])])


def response(system: StateSpace, z: Array) -> Array:
    """Transfer matrices C·(z − A)⁻¹·B + D (ω, p, m) at points (ω,) of the z plane, or of the s plane.

    All points at once, in half to a tenth of the time of `StateSpace.__call__`, which solves anew at every one.
    """
    solved = np.linalg.solve(z[:, None, None] * np.eye(system.nstates) - system.A, system.B.astype(complex))
    return np.asarray(system.C @ solved + system.D)


@dataclass(frozen=True, eq=False)
class Loops:
    """The loops of a machine and its controller about an operating point, each cut while all others are closed.

    Attributes:
        point: its name.
        names: of the loops (a,), those of the actuators.
        plant: the machine, sampled, with its valves' delays, from commands to readings; its states are scaled.
        feedback: the controller, from readings to commands, with the gains that it has there.
        joints: places of the joints that actuators move among the readings.
    """

    point: str
    names: Sequence[str]
    plant: StateSpace
    feedback: StateSpace
    joints: tuple[int, ...]

    @classmethod
    def about(cls, point: Point, axes: Axes, feedback: StateSpace) -> Loops:
        """Those of a machine at a point."""
        names = [each.actuator.name for each in axes.plant.actuators]
        return cls(point.name, names, point.system, feedback, tuple(axes.joints))

    @cached_property
    def closed(self) -> StateSpace:
        """From references of the joints' positions, which are fed back alone, to these positions."""
        names = [self.plant.output_labels[k].removesuffix("_measured") for k in self.joints]
        open_loop, joints = self.plant * self.feedback, list(self.joints)
        # readings y = P·C·(y − r)
        closed = -control.feedback(open_loop, np.eye(open_loop.noutputs), sign=1)[joints, joints]
        return control.ss(closed, inputs=[f"{name}_reference" for name in names], outputs=names,
                          states=[*self.feedback.state_labels, *self.plant.state_labels])

    @cached_property
    def poles(self) -> Array:
        """Of the closed loops, in the z plane."""
        return np.asarray(self.closed.poles())

    @cached_property
    def zeros(self) -> Array:
        """Transmission zeros of the closed loops, in the z plane."""
        found = self.closed.zeros()
        return np.asarray(found[np.abs(found) < INFINITE])

    def steps(self, seconds: float) -> tuple[Array, Array]:
        """Times (N,), and (N, m) the position of each joint after a unit step of its own reference."""
        t = np.asarray(np.arange(int(seconds / self.plant.dt) + 1) * self.plant.dt, dtype=float)
        return t, np.diagonal(control.step_response(self.closed, t, squeeze=False).outputs)

    @cached_property
    def omega(self) -> Array:
        """Frequencies (ω,) [rad/s] at which they are analysed, see `frequencies`."""
        return frequencies([self.plant, self.closed])

    def responses(self, omega: Array) -> Array:
        """L(jω) (a, ω) of each loop; negative feedback.

        The sensitivity of a loop to its own command, 1/(1 + L), is its entry on the diagonal of that of all loops.
        """
        z = np.exp(1j * omega * self.plant.dt)
        sensitivity = np.linalg.inv(np.eye(self.plant.ninputs) - response(self.feedback, z) @ response(self.plant, z))
        return np.asarray(1 / np.diagonal(sensitivity, axis1=1, axis2=2).T - 1)

    @cached_property
    def cut(self) -> Array:
        """The `responses` (a, ω) at `omega`."""
        return self.responses(self.omega)

    @cached_property
    def disks(self) -> Array:
        """Disk margins (a,) of the loops, see `Margin`; zero where the closed loops are not stable."""
        smallest = np.min(2 * np.abs(1 + self.cut) / np.maximum(np.abs(1 - self.cut), np.finfo(float).tiny), axis=1)
        return np.asarray(smallest * (_least_damping(self.closed)[0] > 0))

    @cached_property
    def margins(self) -> tuple[Margin, ...]:
        """Of every loop."""
        damping = (*_least_damping(self.closed), _least_damping(self.plant, STANDING)[0])
        return tuple(_margin(self.point, name, self.omega, L, float(disk), damping)
                     for name, L, disk in zip(self.names, self.cut, self.disks, strict=True))


def _modes(system: StateSpace) -> tuple[Array, Array, Array]:
    """Natural frequencies [rad/s], damping ratios and poles of a sampled system, without those of delays."""
    with np.errstate(divide="ignore", invalid="ignore"):
        size, damping, poles = system.damp()
    some = np.isfinite(size)
    # a pole at 1 exactly neither grows nor decays
    return size[some], np.nan_to_num(damping[some]), poles[some]


def _least_damping(system: StateSpace, standing: float = 0.0) -> tuple[float, float]:
    """Least damping ratio of the poles of a sampled system, and the frequency [rad/s] of that pole; poles within
    `standing` of 1 do not count."""
    size, damping, poles = _modes(system)
    damping = np.where(np.abs(poles - 1) >= standing, damping, np.inf)
    if not np.any(np.isfinite(damping)):
        return 1.0, 0.0
    least = int(np.argmin(damping))
    return float(damping[least]), float(size[least])


def _margin(where: str, name: str, omega: Array, L: Array, disk: float, damping: tuple[float, float, float]) -> Margin:
    """The margins of a loop by its response L(jω) (ω,), with the disk margin that it has there."""
    curve = control.FrequencyResponseData(L, omega, smooth=True)
    gains, phases, distances, at_180, at_one, _ = control.stability_margins(curve, returnall=True)
    # for an unstable loop the factor that would stabilise it
    own = (gains > 1) == (damping[0] >= 0)
    gain, gain_at = _nearest(gains[own], at_180[own], np.abs(np.log(gains[own])))
    phases = np.abs(np.radians(phases))
    phase, phase_at = _nearest(phases, at_one, phases)
    least = float(np.min(distances, initial=np.min(np.abs(1 + L))))
    return Margin(where, name, gain, gain_at, phase, phase_at, least, *damping, disk)


def _nearest(margin: Array, at: Array, measure: Array) -> tuple[float, float]:
    """The margin with the least measure, and its frequency; infinite where there is none."""
    if not len(measure):
        return np.inf, np.nan
    k = int(np.argmin(measure))
    return float(margin[k]), float(at[k])
