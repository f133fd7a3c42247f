"""Machines of the study: what is true of them, as MuJoCo moves them, and the files that hydroopt is given."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
DEGREE = np.pi / 180
MASS, COM, INERTIA = 0.2, 0.08, 0.3
"""σ of a body in a machine file: its mass and moments of inertia as parts, its centre of mass [m]."""
FRICTION = 0.7
"""σ of a friction in a machine file, as a part of it."""


@dataclass(frozen=True)
class Body:
    """Mass [kg], centre of mass [m] and principal moments of inertia about it [kg·m²], along the frame's axes."""

    m: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float]

    def numbers(self) -> Array:
        """The ten inertial parameters about the frame's origin: m, m·c, Ixx, Ixy, Ixz, Iyy, Iyz, Izz."""
        c = np.array(self.com)
        about = np.diag(self.inertia) + self.m * (c @ c * np.eye(3) - np.outer(c, c))
        return np.r_[self.m, self.m * c, about[np.triu_indices(3)]]

    def misjudged(self, rng: np.random.Generator) -> Body:
        """The body as a file states it: wrong as its σ say."""
        errors = np.r_[rng.standard_normal(2), 0.0]  # the planes of symmetry are known
        factor = max(1 + INERTIA * rng.standard_normal(), 0.2)
        return Body(self.m * max(1 + MASS * rng.standard_normal(), 0.3),
                    tuple(np.array(self.com) + COM * errors), tuple(factor * np.array(self.inertia)))

    def stated(self, true: Body) -> str:
        """As a table of a machine file, whose σ are those of the errors that it has against the true body."""
        x, y, z = self.inertia
        com = ", ".join(f'"{value:.9g} m"' for value in self.com)
        moments = ", ".join(f'"{value:.9g} kg*m^2"' for value in (x, 0, 0, y, 0, z))
        return (f'm = {{ value = "{self.m:.9g} kg", sigma = "{MASS * true.m:.9g} kg" }}\n'
                f'com = {{ value = [{com}], sigma = "{COM} m" }}\n'
                f'inertia_com = {{ value = [{moments}], sigma = "{INERTIA * max(true.inertia):.9g} kg*m^2" }}\n')


@dataclass(frozen=True)
class Joint:
    """A hinge about its z axis and the link behind it: a and alpha lead to the next one."""

    name: str
    a: float
    alpha: float
    body: Body
    low: float
    high: float
    speed: float
    coulomb: float = 0.0
    viscous: float = 0.0
    drive: str = ""
    """Kind of drive without a cylinder: "motor" with two pressures, "torque" with a torque sensor."""


@dataclass(frozen=True)
class Cylinder:
    """A barrel on the link before a joint and a rod on the link behind it."""

    name: str
    joint: int
    barrel_pin: tuple[float, float]
    """In the joint's frame at angle zero, but for its origin: see `seat`."""
    rod_pin: tuple[float, float]
    bore: float
    rod: float
    dead: float
    stroke: float
    barrel_body: Body
    rod_body: Body
    coulomb: float
    viscous: float

    @property
    def areas(self) -> tuple[float, float]:
        """Of the head and the rod side [m²]."""
        return np.pi / 4 * self.bore**2, np.pi / 4 * (self.bore**2 - self.rod**2)


@dataclass(frozen=True)
class Truth:
    """A machine as it is. `upright` says that the base's y axis points up, so that joints turn about a level axis."""

    name: str
    joints: tuple[Joint, ...]
    cylinders: tuple[Cylinder, ...]
    upright: bool
    bandwidth: float
    angle_noise: float = 0.02 * DEGREE
    pressure_noise: float = 0.3e5
    torque_noise: float = 0.0
    soft_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Of the base: about it a soft base turns."""
    motor: float = 2.0e-3
    """Torque per pressure of a motor with its gear [N·m/Pa]."""

    @property
    def first(self) -> int:
        """The first joint that lifts: the boom's or the shoulder's."""
        return next(k for k, joint in enumerate(self.joints) if joint.drive != "motor" and (k or not joint.drive))

    def seat(self, joint: int) -> tuple[float, float]:
        """Offset along x and turn about x, from the link before to a joint."""
        before = self.joints[joint - 1] if joint else None
        return (before.a, before.alpha) if before else (0.0, 0.0)

    @property
    def actuators(self) -> list[str]:
        """Names by joint."""
        by_joint = {cylinder.joint: cylinder.name for cylinder in self.cylinders}
        return [by_joint.get(k, f"{joint.name}_drive") for k, joint in enumerate(self.joints)]

    def bodies(self) -> dict[str, Body]:
        """By owner, as hydroopt addresses them."""
        found = {joint.name: joint.body for joint in self.joints}
        for cylinder in self.cylinders:
            found |= {f"{cylinder.name}.barrel": cylinder.barrel_body, f"{cylinder.name}.rod": cylinder.rod_body}
        return found

    def with_body(self, owner: str, body: Body) -> Truth:
        """The machine with another body there."""
        joints = tuple(replace(each, body=body) if each.name == owner else each for each in self.joints)
        cylinders = tuple(replace(each, barrel_body=body) if owner == f"{each.name}.barrel" else
                          replace(each, rod_body=body) if owner == f"{each.name}.rod" else each
                          for each in self.cylinders)
        return replace(self, joints=joints, cylinders=cylinders)

    def parameters(self) -> dict[str, float]:
        """True values by hydroopt's names."""
        keys = ("m", "mc_x", "mc_y", "mc_z", "I_xx", "I_xy", "I_xz", "I_yy", "I_yz", "I_zz")
        found = {f"{owner}.{key}": float(value) for owner, body in self.bodies().items()
                 for key, value in zip(keys, body.numbers(), strict=True)}
        owners = [(f"{each.name}.f", each) for each in self.cylinders]
        for owner, each in [*owners, *((f"{each.name}_drive.tau", each) for each in self.joints if each.drive)]:
            found |= {f"{owner}_coulomb": each.coulomb, f"{owner}_viscous": each.viscous}
        return found


@dataclass(frozen=True)
class Stated:
    """What the machine file says differently, beside bodies and friction that are wrong as their σ say."""

    bore: dict[str, float] = field(default_factory=dict)
    """Factor of the bore by cylinder."""
    rod_pin: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Shift of the rod's pin [m] by cylinder."""


def machine_file(truth: Truth, seed: int, stated: Stated) -> str:
    """The machine file of a seed."""
    rng = np.random.default_rng([seed, 17])
    lines = [f'name = "{truth.name}"', f'bandwidth = "{truth.bandwidth} Hz"', 'gravity = "9.81 m/s^2"']
    lines += ['orientation = ["90 deg", "0 deg", "0 deg"]'] * truth.upright
    for joint in truth.joints:
        lines += ["", "[[links]]", f'name = "{joint.name}"', "[links.joint]", 'type = "revolute"',
                  f'a = "{joint.a} m"', f'alpha = "{np.degrees(joint.alpha):.6g} deg"',
                  f'lower = "{np.degrees(joint.low - 0.05):.6g} deg"',
                  f'upper = "{np.degrees(joint.high + 0.05):.6g} deg"',
                  "[links.body]", joint.body.misjudged(rng).stated(joint.body)]
    for cylinder in truth.cylinders:
        axis = truth.joints[cylinder.joint]
        before = truth.joints[cylinder.joint - 1].name if cylinder.joint else "base"
        a, alpha = truth.seat(cylinder.joint)
        x, y = cylinder.barrel_pin
        turned = (a + x, y * np.cos(alpha), y * np.sin(alpha))
        moved = np.array(cylinder.rod_pin) + stated.rod_pin.get(cylinder.name, (0.0, 0.0))
        lines += ["", "[[cylinders]]", f'name = "{cylinder.name}"',
                  f'bore = "{cylinder.bore * stated.bore.get(cylinder.name, 1.0):.9g} m"',
                  f'rod_diameter = "{cylinder.rod} m"',
                  f'dead_length = "{cylinder.dead} m"', f'stroke = "{cylinder.stroke} m"',
                  *_friction("cylinders", cylinder, "N", "N*s/m", rng),
                  "[cylinders.barrel]", f'link = "{before}"', f"pin = [{_metres(turned)}]",
                  "[cylinders.barrel.body]", cylinder.barrel_body.misjudged(rng).stated(cylinder.barrel_body),
                  "[cylinders.rod]", f'link = "{axis.name}"', f"pin = [{_metres((*moved, 0.0))}]",
                  "[cylinders.rod.body]", cylinder.rod_body.misjudged(rng).stated(cylinder.rod_body)]
    for joint in truth.joints:
        if joint.drive == "motor":
            lines += ["", "[[motors]]", f'name = "{joint.name}_drive"', f'joint = "{joint.name}"',
                      f'torque_per_pressure = "{truth.motor / 100} N*m/Pa"', "gear = 100"]
        elif joint.drive:
            lines += ["", "[[drives]]", f'name = "{joint.name}_drive"', f'joint = "{joint.name}"']
        if joint.drive:
            lines += _friction("motors" if joint.drive == "motor" else "drives", joint, "N*m", "N*m*s/rad", rng)
    angles = [f"{joint.name}.q" for joint in truth.joints]
    lines += _sensor(angles, f"{np.degrees(truth.angle_noise):.6g} deg")
    pressures = [f"{each.name}.{end}" for each in truth.cylinders for end in ("p_head", "p_rod")]
    pressures += [f"{each.name}_drive.{end}" for each in truth.joints if each.drive == "motor"
                  for end in ("p_a", "p_b")]
    torques = [f"{each.name}.tau" for each in truth.joints if each.drive == "torque"]
    lines += _sensor(pressures, f"{truth.pressure_noise / 1e5} bar") if pressures else []
    lines += _sensor(torques, f"{truth.torque_noise} N*m") if torques else []
    return "\n".join(lines) + "\n"


def _metres(values: tuple[float, ...]) -> str:
    return ", ".join(f'"{value:.9g} m"' for value in values)


def _friction(table: str, each: Cylinder | Joint, force: str, per_speed: str, rng: np.random.Generator) -> list[str]:
    wrong = np.maximum(1 + FRICTION * rng.standard_normal(2), 0.1)
    entries = zip(("coulomb", "viscous"), (each.coulomb, each.viscous), (force, per_speed), wrong, strict=True)
    return [f"[{table}.friction]", *(
        f'{key} = {{ value = "{value * factor:.9g} {unit}", sigma = "{FRICTION * value:.9g} {unit}" }}'
        for key, value, unit, factor in entries)]


def _sensor(channels: list[str], accuracy: str) -> list[str]:
    names = ", ".join(f'"{each}"' for each in channels)
    return ["", "[[sensors]]", f"channels = [{names}]", f'accuracy = "{accuracy}"', 'distribution = "gaussian"',
            'rate = "50 Hz"']


def _slender(m: float, x: float, y: float, turn: float) -> Body:
    return Body(m, (x, y, 0.0), (0.1 * turn, turn, turn))


_BOOM = Joint("boom", 3.0, 0.0, _slender(450.0, 1.3, 0.15, 400.0), -18 * DEGREE, 48 * DEGREE, 0.35)
_STICK = Joint("stick", 1.6, 0.0, _slender(250.0, 0.7, 0.05, 90.0), np.radians(-128), np.radians(-42), 0.5)
_BOOM_CYLINDER = Cylinder("boom_cylinder", 0, (0.45, -0.45), (1.5, -0.05), 0.08, 0.045, 0.92, 0.78,
                          _slender(40.0, 0.4, 0.0, 2.5), _slender(25.0, -0.35, 0.0, 1.2), 600.0, 3000.0)
_STICK_CYLINDER = Cylinder("stick_cylinder", 1, (-1.7, 0.5), (-0.4, 0.15), 0.063, 0.036, 1.46, 0.66,
                           _slender(30.0, 0.45, 0.0, 2.5), _slender(20.0, -0.4, 0.0, 1.2), 300.0, 2000.0)

EXCAVATOR = Truth("excavator", (_BOOM, _STICK), (_BOOM_CYLINDER, _STICK_CYLINDER), True, 2.0)
CRANE = Truth("crane", (
    Joint("slew", 0.3, np.pi / 2, Body(900.0, (0.2, 0.0, 0.3), (300.0, 300.0, 350.0)), np.radians(-150),
          np.radians(150), 0.5, 900.0, 1500.0, "motor"),
    replace(_BOOM, name="lift"), replace(_STICK, name="jib")), (
        replace(_BOOM_CYLINDER, name="lift_cylinder", joint=1), replace(_STICK_CYLINDER, name="jib_cylinder", joint=2)),
    False, 2.0, soft_axis=(0.0, 1.0, 0.0))
ARM = Truth("arm", (
    Joint("pan", 0.0, np.pi / 2, Body(6.0, (0.02, 0.0, -0.03), (0.03, 0.03, 0.02)), -2.5, 2.5, 1.5, 6.0, 8.0, "torque"),
    Joint("shoulder", 0.6, 0.0, _slender(12.0, 0.25, 0.02, 0.8), -0.3, 1.8, 1.2, 8.0, 9.0, "torque"),
    Joint("elbow", 0.5, 0.0, _slender(7.0, 0.22, 0.03, 0.25), -2.2, 1.0, 1.5, 4.0, 5.0, "torque")), (),
    False, 5.0, angle_noise=2e-5, torque_noise=0.6, soft_axis=(0.0, 1.0, 0.0))
MACHINES = {each.name: each for each in (EXCAVATOR, CRANE, ARM)}
