"""What tests of a fit look at: one log's readings and what the model predicts for them, with every derivative."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d, median_filter

from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.friction_sign import Courses
from hydroopt.logs.forces_from_pressures import force_channels, force_noise
from hydroopt.logs.joint_angles import angle_noise, measured_angles
from hydroopt.logs.lag import stretches
from hydroopt.logs.readings import bridged
from hydroopt.logs.recording import Recording
from hydroopt.logs.smoothing import Motion
from hydroopt.logs.spline import MIN_SAMPLES, Basis, Grid, wider
from hydroopt.machine.actuators import Cylinder, Drive
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

SPIKE = 6.0
"""Distance from the running median, in robust standard deviations, beyond which a residual is a spike."""
EXCESS, AGAIN = 1.05, 4
"""What smoothing takes out as a multiple of the stated noise, beyond which some of it is motion; by what the number of
smoothings of what is left is multiplied then."""
UNKNOWN = 0.2
"""Part of what errors of the motion add to a reading that counts as white noise at least: their covariance is itself
known to about this part, since smoothing in several passes is taken as one of the same bandwidth, and to first order.
Where a sensor is better than that, or nothing is read, as at a passive joint, these errors are all that is left."""
REVERSAL = 0.12
"""Time [s] about a reversal in which friction is neither that before nor that after: seals give before they slip."""
STEP = 1e-5
"""Step of finite differences as a part of the RMS of a coordinate."""


@dataclass(frozen=True, eq=False)
class View:
    """Residuals (N, c) of the c readings of a log: the forces of all balances, then measured lengths of cylinders.

    Attributes:
        experiment: the log and its smoothed motion.
        psi: (p,) parameters about which everything is linear.
        lengths: places in the machine's cylinders of the lengths that are measured beside the angles.
        span: first and last time [s] of the log, of which the experiment may be a part.
    """

    experiment: Experiment
    psi: Array
    lengths: tuple[int, ...]
    span: tuple[float, float]

    @classmethod
    def of(cls, experiment: Experiment, psi: Array, span: tuple[float, float] | None = None) -> View:
        """The view of an experiment at ψ, of a log that lasts for `span`, by default for as long as the experiment."""
        machine, channels = experiment.model.machine, experiment.log.channels
        beside = tuple(k for k, c in enumerate(machine.cylinders) if f"{c.name}.length" in channels and all(
            f"{joint}.q" in channels for joint in machine.moved_by(c)))
        view = cls(experiment, psi, beside, span or (float(experiment.motion.t[0]), float(experiment.motion.t[-1])))
        again = _too_smooth(experiment)
        return replace(view, experiment=replace(experiment, motion=view._followed_closer(again))) if again else view

    @cached_property
    def kept(self) -> dict[Hashable, Array]:
        """What was computed of this view for one fault, and is needed for others."""
        return {}

    @property
    def model(self) -> Model:
        """The machine's model."""
        return self.experiment.model

    @property
    def motion(self) -> Motion:
        """The smoothed motion."""
        return self.experiment.motion

    @cached_property
    def elapsed(self) -> Array:
        """Part (N,) of the log that has gone by."""
        begun, ended = self.span
        return np.asarray((self.motion.t - begun) / (ended - begun))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Balances and length channels, reading by reading."""
        machine = self.model.machine
        return (*(each.name for each in machine.balances),
                *(f"{machine.cylinders[k].name}.length" for k in self.lengths))

    @property
    def read(self) -> NDArray[np.bool_]:
        """Which of them (c,) are read by a sensor: all but the balances of passive joints, where nothing acts."""
        balances = [bool(each.actuators) for each in self.model.machine.balances]
        return np.array([*balances, *[True] * len(self.lengths)])

    def readings(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Predicted readings (N, c) of a motion (N, n) at ψ."""
        motion = replace(self.motion, q=q, qd=qd, qdd=qdd)
        force = replace(self.experiment, motion=motion).predicted(self.psi)
        if not self.lengths:
            return force
        return np.column_stack([force, self._own_lengths if q is self.motion.q else self._lengths(q)])

    @cached_property
    def _own_lengths(self) -> Array:
        return self._lengths(self.motion.q)

    def _lengths(self, q: Array) -> Array:
        made = self.model.over(self.model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, :, 0]
        return made[:, list(self.lengths)]

    @cached_property
    def predicted(self) -> Array:
        """Predicted readings (N, c) of the smoothed motion."""
        return self.readings(self.motion.q, self.motion.qd, self.motion.qdd)

    @cached_property
    def measured(self) -> Array:
        """Measured readings (N, c); the predicted ones, which are not `usable`, where the log does not tell a force."""
        log, cylinders = self.experiment.log, self.model.machine.cylinders
        lengths = [log.channels[f"{cylinders[k].name}.length"] for k in self.lengths]
        read = np.column_stack([self.experiment.force, *lengths])
        return np.where(np.isfinite(read), read, self.predicted)

    @cached_property
    def residual(self) -> Array:
        """Measured minus predicted readings (N, c)."""
        return self.measured - self.predicted

    @cached_property
    def spikes(self) -> NDArray[np.bool_]:
        """Readings (N, c) far off their neighbours."""
        off = self.residual - median_filter(self.residual, 7, mode="nearest", axes=(0,))
        used = self.motion.interior
        size = 1.4826 * np.median(np.abs(off[used]), axis=0) if used.any() else np.ones(off.shape[1])
        least = np.maximum(1e-9 * np.abs(self.predicted).max(axis=0) + 1e-300, UNKNOWN * self.of_motion)
        return np.asarray(self.read & (np.abs(off) > SPIKE * np.maximum(size, least)))

    @cached_property
    def motion_errors(self) -> Array:
        """What errors of the measured positions add to the readings (N, c), after smoothing: one draw of them."""
        errors, rng = np.zeros_like(self.predicted), np.random.default_rng(0)
        for joint, std in enumerate(self.angle_noise):
            drawn = self.smoothed(std * rng.standard_normal(len(errors)), joint)
            errors += np.einsum("on,onc->nc", drawn, self.by_motion[:, :, :, joint])
        return errors

    @cached_property
    def of_motion(self) -> Array:
        """RMS (c,) of `motion_errors`."""
        squares = np.where(self.usable, self.motion_errors, 0.0) ** 2
        return np.asarray(np.sqrt(np.sum(squares, axis=0) / np.maximum(self.usable.sum(axis=0), 1)))

    @cached_property
    def smoothed_away(self) -> Array:
        """What each joint's smoothing takes from the readings (N, c, n): nearly that which it takes when done again."""
        made = np.empty((*self.predicted.shape, self.motion.q.shape[1]))
        for joint in range(made.shape[2]):
            state = np.stack([self.motion.q[:, joint], self.motion.qd[:, joint], self.motion.qdd[:, joint]])
            lost = state - self.smoothed(self.motion.q[:, joint], joint)
            made[:, :, joint] = np.einsum("on,onc->nc", lost, self.by_motion[:, :, :, joint])
        return made

    @cached_property
    def reverses(self) -> NDArray[np.bool_]:
        """Readings (N, c) near a reversal of what their dry friction follows: its course there is in no model."""
        speed, t = self.courses.speeds(self.motion.q, self.motion.qd), self.motion.t
        turns = np.zeros(speed.shape, dtype=bool)
        turns[1:] = np.sign(speed[1:]) != np.sign(speed[:-1])
        window = 2 * round(REVERSAL / float(np.median(np.diff(t)))) + 1
        own = self.courses.in_any(maximum_filter1d(turns.astype(np.uint8), window, axis=0).astype(bool))
        return np.column_stack([own, np.zeros((len(own), len(self.lengths)), dtype=bool)])

    @cached_property
    def friction(self) -> Array:
        """Friction of the model at ψ (N, c)."""
        own = [k for k, kind in enumerate(self.model.parameters.kinds) if kind.is_friction]
        return np.asarray(self.regressor[:, :, own] @ self.psi[own])

    @cached_property
    def taken(self) -> NDArray[np.bool_]:
        """Readings (N, c) that take part: the joint moves, and they are no spikes."""
        return np.asarray(self.usable & ~self.spikes)

    @cached_property
    def usable(self) -> NDArray[np.bool_]:
        """Readings (N, c) away from the ends of stretches and, of forces, from standstill and reversals."""
        inside = self.motion.interior[:, None]
        forces = inside & self.experiment.known
        return np.column_stack([forces, np.broadcast_to(inside, (len(inside), len(self.lengths)))])

    @cached_property
    def slowest(self) -> Array:
        """Speed (c,) of what dry friction follows at which its sign is known in this log; inf where it never is."""
        speeds = np.abs(self.courses.speeds(self.motion.q, self.motion.qd))
        found = np.full(speeds.shape[1], np.inf)
        for known, own in zip(self.experiment.known.T, self.courses.of_balances, strict=True):
            for column in own:
                found[column] = min(found[column], np.min(speeds[known, column], initial=np.inf))
        return found

    @cached_property
    def courses(self) -> Courses:
        """What dry friction follows."""
        return Courses.of(self.model)

    @cached_property
    def spike_share(self) -> Array:
        """Share (c,) of the usable readings that are spikes."""
        return np.asarray(np.sum(self.usable & self.spikes, axis=0) / np.maximum(np.sum(self.usable, axis=0), 1))

    @cached_property
    def stated_noise(self) -> Array:
        """Standard deviation (c,) of the readings that the machine file states; NaN where it states none."""
        machine = self.model.machine
        sensors = [machine.sensor(name) for name in self.names[len(machine.balances):]]
        return np.append(force_noise(self.model, self.experiment.log), [s.std if s else np.nan for s in sensors])

    @cached_property
    def noise(self) -> Array:
        """Standard deviation (c,) of the readings' white noise, from second differences of residuals; at least
        `UNKNOWN` of what errors of the motion add."""
        found, segment = np.empty(len(self.names)), self.motion.segment
        whole = np.concatenate([[False], (segment[2:] == segment[:-2]), [False]])
        for k in range(len(found)):
            use = whole & self.taken[:, k] & np.roll(self.taken[:, k], 1) & np.roll(self.taken[:, k], -1)
            at = np.flatnonzero(use)
            r = self.residual[:, k]
            found[k] = np.sqrt(np.mean((r[at - 1] - 2 * r[at] + r[at + 1]) ** 2) / 6) if at.size > 20 else np.nan
        found *= self._hidden_noise
        size = np.sqrt(np.mean(self.measured**2, axis=0))
        floor = np.fmax(1e-6 * size + 1e-12, 1e-2 * np.nan_to_num(self.stated_noise))
        floor = np.maximum(floor, UNKNOWN * self.of_motion)
        return np.asarray(np.fmax(np.where(np.isfinite(found), found, np.nan_to_num(self.stated_noise)), floor))

    @property
    def _hidden_noise(self) -> Array:
        """White noise of the readings (c,) over what second differences show where channels were interpolated."""
        log, n = self.experiment.log, len(self.model.machine.balances)
        made = np.ones(len(self.names))
        if isinstance(log.recording, Recording):
            channels = force_channels(self.model, log) & set(log.recording.channels)
            made[:n] = max((log.recording.hidden_noise(channel, log.t) for channel in channels), default=1.0)
            made[n:] = [log.recording.hidden_noise(name, log.t) for name in self.names[n:]]
        return made

    @cached_property
    def angle_noise(self) -> Array:
        """Standard deviation (n,) of the measured positions: as stated, or what smoothing took out if that is more."""
        out = measured_angles(self.model, self.experiment.log) - self.motion.q
        took = np.sqrt(np.mean(out**2, axis=0))
        stated = np.nan_to_num(angle_noise(self.model, self.experiment.log))
        return np.asarray(np.maximum(np.maximum(stated, took), 1e-9))

    @cached_property
    def by_position(self) -> Array:
        """What constant errors of the joints' positions of one standard deviation add to the readings (N, c, n)."""
        std = self.experiment.position_std
        return np.zeros((*self.predicted.shape, self.motion.q.shape[1])) if std is None else self.by_motion[0] * std

    @cached_property
    def by_motion(self) -> Array:
        """Derivatives (3, N, c, n) of the predicted readings by q, qd and qdd, steps of dry friction aside."""
        state = [self.motion.q, self.motion.qd, self.motion.qdd]
        made = np.empty((3, *self.predicted.shape, state[0].shape[1]))
        for order in range(3):
            sizes = STEP * np.maximum(np.sqrt(np.mean(state[order] ** 2, axis=0)), 1e-3)
            for j, h in enumerate(sizes):
                up, down = list(state), list(state)
                up[order], down[order] = state[order].copy(), state[order].copy()
                up[order][:, j] += h
                down[order][:, j] -= h
                made[order, :, :, j] = (self.readings(*up) - self.readings(*down)) / (2 * h)
        return made

    @cached_property
    def regressor(self) -> Array:
        """Derivatives (N, c, p) of the predicted readings by ψ."""
        return self.regressor_of(self.motion.q, self.motion.qd, self.motion.qdd)

    @cached_property
    def of_bodies(self) -> Mapping[str, Array]:
        """What the nominal numbers of each body make of the readings (N, c)."""
        parameters = self.model.parameters
        chosen = np.zeros((len(parameters), len(parameters.bodies)))
        for k, columns in enumerate(parameters.bodies.values()):
            chosen[columns, k] = parameters.nominal[columns]
        return dict(zip(parameters.bodies, np.moveaxis(self.regressor @ chosen, 2, 0), strict=True))

    def regressor_of(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Derivatives (N, c, p) of the readings of a motion (N, n) by ψ."""
        K = replace(self.experiment, motion=replace(self.motion, q=q, qd=qd, qdd=qdd)).equations(self.psi)[0][0]
        return np.concatenate([K, np.zeros((len(K), len(self.lengths), K.shape[2]))], axis=1)

    def moved(self, shift: Array) -> tuple[Array, Array, Array]:
        """The smoothed motion at other times: shift (N,) or (N, n) [s] later, nothing beyond the ends of a stretch."""
        t = self.motion.t
        shift = np.broadcast_to(shift if np.ndim(shift) == 2 else np.reshape(shift, (-1, 1)), self.motion.q.shape)
        out = np.stack([self.motion.q, self.motion.qd, self.motion.qdd])
        for a, b, course in self._courses:
            if not np.any(shift[a:b]):
                continue
            same = np.ptp(shift[a:b], axis=1).max() == 0
            for j in range(1 if same else out.shape[2]):
                if same or np.any(shift[a:b, j]):
                    chosen = slice(None) if same else slice(j, j + 1)
                    at = np.clip(t[a:b] + shift[a:b, j], t[a], t[b - 1])
                    out[:, a:b, chosen] = np.moveaxis(course(at)[:, :, chosen], 0, 1)
        return out[0], out[1], out[2]

    @cached_property
    def _courses(self) -> list[tuple[int, int, CubicSpline]]:
        """First sample of each stretch, one after its last, and q, qd and qdd (3, n) over time."""
        state = np.stack([self.motion.q, self.motion.qd, self.motion.qdd], axis=1)
        return [(a, b, CubicSpline(self.motion.t[a:b], state[a:b])) for a, b in stretches(self.motion.segment)
                if b - a >= 8]

    def smoothed(self, course: Array, joint: int) -> Array:
        """What smoothing makes of a course (N,) in a joint's measured position: its part of q, qd and qdd (3, N)."""
        motion, made = self.motion, np.zeros((3, len(course)))
        for a, b, basis in self._splines:
            chosen = basis.filter_of(float(motion.bandwidth[joint]), int(motion.passes[joint]))
            made[:, a:b] = basis.smoothed(course[a:b], chosen)
        return made

    @cached_property
    def _splines(self) -> list[tuple[int, int, Basis]]:
        """First sample of each stretch, one after its last, and splines at its times."""
        t = self.motion.t
        return [(a, b, Basis(t[a:b], Grid.of(t[a:b]))) for a, b in stretches(self.motion.segment)
                if b - a >= MIN_SAMPLES]

    def _followed_closer(self, joints: Sequence[int]) -> Motion:
        """The motion with these joints' positions followed closer, since smoothing takes away some of the motion.

        Smoothing what is left `AGAIN` times as often passes at least a third more of the frequencies.
        """
        passes, bandwidth = self.motion.passes.copy(), self.motion.bandwidth.copy()
        for joint in joints:
            bandwidth[joint] *= wider(AGAIN * passes[joint]) / wider(passes[joint])
            passes[joint] *= AGAIN
        closer = replace(self.motion, passes=passes, bandwidth=bandwidth)
        view = replace(self, experiment=replace(self.experiment, motion=closer))
        angles = measured_angles(self.model, self.experiment.log)
        state = np.array([closer.q, closer.qd, closer.qdd])
        for joint in joints:
            state[:, :, joint] = view.smoothed(angles[:, joint], joint)
        return replace(closer, q=state[0], qd=state[1], qdd=state[2])

    @cached_property
    def weights(self) -> Array:
        """`gravity` at ψ."""
        return self.gravity(self.psi)

    def gravity(self, psi: Array) -> Array:
        """Forces (N, c, 3) of the bodies' weights per unit [m/s²] of gravity along the axes of the base frame."""
        forces = self.model.over(self.model.gravity_forces, self.motion.q, psi)[0]
        return np.concatenate([forces, np.zeros((len(forces), len(self.lengths), 3))], axis=1)

    @cached_property
    def pressures(self) -> Mapping[str, Array]:
        """Pressures [Pa] (N,) by channel, without the share of the force's noise that is theirs, and low-passed."""
        machine, log, found = self.model.machine, self.experiment.log, dict[str, Array]()
        for k, balance in enumerate(machine.balances):
            read = [each for each in balance.actuators
                    if not isinstance(each, Drive) and set(each.chambers) <= set(log.channels)]
            sensors = [machine.sensor(channel) for each in read for channel in each.chambers]
            stds = np.array([sensor.std if sensor else np.nan for sensor in sensors])
            factors = np.column_stack([self.arms[:, k, machine.actuators.index(each)] * each.effort_factors[channel]
                                       for each in read for channel in each.chambers] or [np.zeros((1, 0))])
            variance = np.where(np.all(np.isfinite(stds) & (stds > 0)), stds, 1.0) ** 2
            parts = factors * variance / np.sum(factors**2 * variance, axis=1, keepdims=True)
            for channel, part in zip((channel for each in read for channel in each.chambers), parts.T, strict=True):
                found[channel] = _slow(bridged(log.channels[channel]) - part * self.residual[:, k], self.window)
        return found

    @cached_property
    def arms(self) -> Array:
        """Measured forces of the balances per force of each actuator (N, r, a); (1, r, a) where they are the same."""
        model = self.model
        return np.eye(len(model.machine.balances))[None] if model.machine.one_each else np.asarray(
            model.over(model.shares, self.motion.q)[0])

    @cached_property
    def contributions(self) -> Mapping[str, Array]:
        """What each of the `pressures` adds to the readings (N, c)."""
        machine, found = self.model.machine, dict[str, Array]()
        for a, actuator in enumerate(machine.actuators):
            for channel in set(actuator.effort_factors) & set(self.pressures):
                found[channel] = np.zeros_like(self.predicted)
                found[channel][:, : len(machine.balances)] = (
                    self.arms[:, :, a] * (actuator.effort_factors[channel] * self.pressures[channel])[:, None])
        return found

    @cached_property
    def window(self) -> int:
        """Samples (odd) that a slow signal is averaged over: a quarter of the smoothing's shortest period."""
        step = float(np.median(np.diff(self.motion.t)))
        return 2 * int(max(2.0, 0.125 / (float(np.max(self.motion.bandwidth)) * step))) + 1

    @cached_property
    def speeds(self) -> Array:
        """Speed (N, c) [m/s or rad/s] of the actuator or, where it is not one, of the joint of each reading."""
        machine, motion = self.model.machine, self.motion
        strokes = (self.model.over(self.model.cylinder_kinematics, motion.q, motion.qd, motion.qdd)[1][:, :, 0]
                   if machine.cylinders else np.zeros((len(motion.t), 0)))
        made = [strokes[:, machine.pinned.index(each.alone)] if isinstance(each.alone, Cylinder)
                else motion.qd[:, j] for each, j in zip(machine.balances, self.model.dynamics.kept, strict=True)]
        return np.column_stack([*made, *(strokes[:, k] for k in self.lengths)])


def _slow(x: Array, window: int) -> Array:
    calm = median_filter(x, window, mode="nearest")
    padded = np.pad(calm, window // 2, mode="edge")
    return np.convolve(padded, np.full(window, 1.0 / window), mode="valid")


def _too_smooth(experiment: Experiment) -> list[int]:
    """Joints whose motion is smoothed more than noise calls for, by a stated bandwidth."""
    motion, model = experiment.motion, experiment.model
    stated = angle_noise(model, experiment.log)
    took = np.sqrt(np.mean((measured_angles(model, experiment.log) - motion.q) ** 2, axis=0))
    return [int(j) for j in np.flatnonzero((motion.passes > 1) | (took > EXCESS * stated))]
