"""An independent look at a motion: moments about the footprint's edges by differences of positions, dense clearances.

A body's particles at ``p + R·ξ`` push on the ground with ``−∫(ẍ − g) dm``; p and R come from forward kinematics, their
second time derivatives from central differences of positions. No speed, acceleration, regressor or derivative of the
limits takes part.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.interpolate import BPoly

from hydroopt import Model
from hydroopt.excitation.motion.excitation import Excitation
from hydroopt.limits.parts import pairs
from hydroopt.parameters.dynamic import bodies
from hydroopt.simulation import simulate as synthetic

FINER, STEP = 3, 1e-3
"""Times per sample of the controller, and the step of differences [s]."""
POINTS = 41
"""Points of every line between which distances are measured."""
DRAWS = 100


class Witness:
    """What limits are in a motion, by other ways than the design's."""

    def __init__(self, model: Model, found: Excitation, rng: np.random.Generator) -> None:
        self.model, self.machine, self.rng = model, model.machine, rng
        path = found.trajectory
        self.path, self.reserves = path, found.problem.limits.reserves
        self.course = BPoly.from_derivatives(path.t, np.stack([path.q, path.qd, path.qdd], axis=1))
        count = FINER * (len(path.t) - 1) + 1
        self.t = np.linspace(path.t[0] + STEP, path.t[-1] - STEP, count)
        self.psi = self._draws()
        foot, notes = self.machine.footprint, self.machine.notes
        # the chassis is as uncertain as the file states, independently of the bodies
        self.mass = foot.mass * (1 + notes["footprint.mass"].sigma * rng.standard_normal(DRAWS))
        self.com = np.array(foot.com) + notes["footprint.com"].sigma * rng.standard_normal((DRAWS, 3))

    def _draws(self) -> np.ndarray:
        """(DRAWS, p) parameters by the file's confidences, bodies possible wherever that is not too rare."""
        parameters = self.model.parameters
        made, taken = np.tile(parameters.nominal, (DRAWS, 1)), np.zeros(len(parameters), dtype=bool)
        for block in parameters.bodies.values():
            taken[block] = True
            if np.any(parameters.information[block, block]):
                root = np.linalg.cholesky(np.linalg.inv(parameters.information[block, block]))
                drawn = parameters.nominal[block] + self.rng.standard_normal((20 * DRAWS, 10)) @ root.T
                order = np.argsort([not _possible(each) for each in drawn], kind="stable")
                made[:, block] = drawn[order[:DRAWS]]
        for k in np.flatnonzero(~taken & (np.diag(parameters.information) > 0)):
            made[:, k] += self.rng.standard_normal(DRAWS) / np.sqrt(parameters.information[k, k])
            made[:, k] = np.clip(made[:, k], parameters.lower[k], parameters.upper[k])
        return made

    def tipping(self) -> tuple[np.ndarray, np.ndarray]:
        """Moments (DRAWS, N, edges) that hold the machine on its footprint, moving and stopped, per reserve of each."""
        machine, foot = self.machine, self.machine.footprint
        owners = list(bodies(machine, actuator_inertia=self.model.actuator_inertia))
        q = self.model.coordinates.q
        poses = ca.Function("poses", [q], [ca.horzcat(*(ca.horzcat(pose.rotation, pose.origin) for pose in (
            self.model.dynamics.body_motion(owner).pose for owner in owners)))])
        at = [np.asarray(poses.map(len(self.t))(self.course(self.t + shift).T)).reshape(
            3, len(self.t), len(owners), 4).transpose(1, 2, 0, 3) for shift in (-STEP, 0.0, STEP)]
        second = (at[0] - 2 * at[1] + at[2]) / STEP**2
        roll, pitch, _ = machine.orientation
        down = np.array([np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)]) * machine.gravity
        corners = np.array([[*corner, machine.ground] for corner in foot.corners])
        edges = np.roll(corners, -1, axis=0) - corners
        edges /= np.linalg.norm(edges, axis=1)[:, None]
        masses = np.array([self.model.parameters.bodies[owner].start for owner in owners])
        phi = np.stack([self.psi[:, self.model.parameters.bodies[owner]] for owner in owners], axis=1)
        found = []
        for moves in (1.0, 0.0):
            pushed = moves * second[..., 3] - down  # (N, bodies, 3): p̈ − g
            rotated, turned = at[1][..., :3], moves * second[..., :3]
            holding = np.empty((DRAWS, len(self.t), len(corners)))
            for k, (corner, along) in enumerate(zip(corners, edges, strict=True)):
                columns = self._columns(at[1][..., 3] - corner, pushed, rotated, turned, along)
                holding[..., k] = np.einsum("tbi,dbi->dt", columns, phi)
                holding[..., k] += ((np.cross(self.com - corner, -self.mass[:, None] * down)) @ along)[:, None]
            found.append(holding)
        middle = corners.mean(axis=0)
        arms = np.array([np.cross(along, middle - corner)[2] for corner, along in zip(corners, edges, strict=True)])
        weight = machine.gravity * (foot.mass + self.model.parameters.nominal[masses].sum())
        return np.minimum(*found), self.reserves.tipping * weight * arms

    @staticmethod
    def _columns(away: np.ndarray, pushed: np.ndarray, rotated: np.ndarray, turned: np.ndarray,
                 along: np.ndarray) -> np.ndarray:
        """(N, bodies, 10) moment about an edge per inertial parameter m, mc, I."""
        N, B = away.shape[:2]
        made = np.empty((N, B, 10))
        made[..., 0] = np.cross(away, pushed) @ along
        for j in range(3):
            made[..., 1 + j] = (np.cross(away, turned[..., j]) + np.cross(rotated[..., j], pushed)) @ along
        # ∫ξξᵀ dm is half the trace of I on its diagonal less I
        by = np.array([[np.cross(rotated[..., j], turned[..., k]) @ along for k in range(3)] for j in range(3)])
        trace = by[0, 0] + by[1, 1] + by[2, 2]
        for place, (j, k) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
            made[..., 4 + place] = trace / 2 - by[j, j] if j == k else -(by[j, k] + by[k, j])
        return made

    def pressures(self) -> tuple[np.ndarray, np.ndarray]:
        """Largest pressures (DRAWS, N, chambers) as parts of relief pressures, by forces of simulated logs."""
        rows = []
        for psi in self.psi:
            force = synthetic.forces(self.model, self.path, psi)
            rows.append(np.column_stack([
                (sign * force[:, k] + other * synthetic.BACK_PRESSURE) / area / each.relief_pressure
                for k, each in enumerate(self.machine.actuators) if getattr(each, "relief_pressure", None)
                for sign, area, other in ((1, *each.areas), (-1, *each.areas[::-1]))]))
        return np.array(rows), np.array(1 - self.reserves.pressure)

    def clearances(self) -> dict[str, float]:
        """By how much the least distances exceed the reserves [m], in points along all lines at all times."""
        lines = self._lines()
        least = {}
        for name, (points, radius) in lines.items():
            low = points[:, -1, 2] if name in self.names else np.min(points[..., 2], axis=1)
            if np.ptp(low) > 1e-9:
                least[f"{name} ground"] = float(np.min(low)) - radius - self.machine.ground - self.reserves.clearance
        for obstacle in self.machine.obstacles:
            if obstacle.link == "base":
                centre = np.broadcast_to(np.array(obstacle.centre), (len(self.t), 3))
            else:
                frame = self.frames[obstacle.link]
                centre = frame[:, :3, :3] @ np.array(obstacle.centre) + frame[:, :3, 3]
            for name, (points, radius) in lines.items():
                carried = self.carriers[name]
                if name == obstacle.link or (obstacle.link in carried and name not in self.names):
                    continue
                watched = points[:, POINTS // 2:] if obstacle.link in carried else points
                away = np.linalg.norm(watched - centre[:, None], axis=2)
                if np.ptp(np.min(away, axis=1)) > 1e-9:
                    least[f"{name} {obstacle.name}"] = float(
                        np.min(away)) - radius - obstacle.radius - self.reserves.clearance
        for one, other in pairs(self.model, 0.6):
            (first, a), (second, b) = lines[one.name], lines[other.name]
            away = np.linalg.norm(first[:, :, None] - second[:, None], axis=3)
            least[f"{one.name} {other.name}"] = float(np.min(away)) - a - b - self.reserves.between
        return least

    def _lines(self) -> dict[str, tuple[np.ndarray, float]]:
        """Points (N, POINTS, 3) along every link and cylinder, and radii; sets frames and carriers."""
        q, machine = self.course(self.t), self.machine
        far = self.model.over(self.model.forward_kinematics, q)
        self.names = [link.name for link in machine.links]
        self.frames = {}
        for link, pose in zip(machine.links, far, strict=True):
            end = self.model.geometry.far_end(link.name)
            inner = np.eye(4)
            inner[:3, :3], inner[:3, 3] = np.asarray(end.rotation), np.asarray(end.origin).ravel()
            self.frames[link.name] = pose @ np.linalg.inv(inner)
        share = np.linspace(0, 1, POINTS)[:, None]
        made = {link.name: ((1 - share) * self.frames[link.name][:, None, :3, 3] + share * pose[:, None, :3, 3], 0.0)
                for link, pose in zip(machine.links, far, strict=True)
                if link.body is not None or np.any(np.asarray(self.model.geometry.far_end(link.name).origin))}
        self.carriers = {link.name: {link.parent} for link in machine.links}
        for each in machine.cylinders:
            ends = [np.broadcast_to(np.array(pin.pin), (len(q), 3)) if pin.link == "base" else
                    self.frames[pin.link][:, :3, :3] @ np.array(pin.pin) + self.frames[pin.link][:, :3, 3]
                    for pin in (each.barrel, each.rod)]
            made[each.name] = ((1 - share) * ends[0][:, None] + share * ends[1][:, None],
                               float(np.sqrt(each.areas[0] / each.jacks / np.pi)))
            self.carriers[each.name] = {each.barrel.link, each.rod.link}
        return made


def _possible(phi: np.ndarray) -> bool:
    m, mc, (xx, xy, xz, yy, yz, zz) = phi[0], phi[1:4], phi[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    pseudo = np.zeros((4, 4))
    pseudo[:3, :3], pseudo[:3, 3], pseudo[3, :3], pseudo[3, 3] = np.trace(inertia) / 2 * np.eye(3) - inertia, mc, mc, m
    return bool(np.linalg.eigvalsh(pseudo)[0] > 0)
