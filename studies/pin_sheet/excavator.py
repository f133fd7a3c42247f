"""The excavator in its plane, written a second time: a numeric loop, no formula, and derivatives by complex steps."""

from collections.abc import Callable

import numpy as np

HEIGHT, BARREL = 0.7, (0.9, -0.225)
"""Of the boom's pin above the ground [m]; the boom cylinder's barrel pin from there [m]. Both count as known."""
POSTURE = {"bucket": np.radians(-17.1), "rocker": np.radians(80.0)}
"""In which the linkage is assembled [rad]."""
STEPS, ITERATIONS, STEP = 40, 12, 1e-30

Numbers = dict[str, complex | np.ndarray]


def observed(of: Numbers, q: np.ndarray) -> np.ndarray:
    """Three cylinder lengths and the tip (N, 6) [m], at joints (N, 4) [rad], as a pin sheet `of` numbers says."""
    swing, boom, stick, bucket = q.T
    dead = {"boom": 2.45, "stick": 3.1, "bucket": 1.95}

    def at(origin: tuple, angle: np.ndarray, x: complex, y: complex) -> tuple:
        c, s = np.cos(angle), np.sin(angle)
        return origin[0] + c * x - s * y, origin[1] + s * x + c * y

    def pin(origin: tuple, angle: np.ndarray, name: str) -> tuple:
        return at(origin, angle, of[f"{name}.x"], of[f"{name}.y"])

    here = (0.0, 0.0)
    elbow, turned = at(here, boom, of["boom.a"], 0.0), boom + stick
    wrist, rolled = at(elbow, turned, of["stick.a"], 0.0), boom + stick + bucket
    tip = at(wrist, rolled, of["bucket.a"], 0.0)
    rocker = turned + _rocker(of, bucket)
    ends = {"boom": (BARREL, pin(here, boom, "boom_cylinder.rod")),
            "stick": (pin(here, boom, "stick_cylinder.barrel"), pin(elbow, turned, "stick_cylinder.rod")),
            "bucket": (pin(elbow, turned, "bucket_cylinder.barrel"),
                       pin(pin(elbow, turned, "rocker.pin"), rocker, "bucket_cylinder.rod"))}
    # a sensor that was set to zero with the sheet's dead length reads what the true one is off
    lengths = [np.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2) + dead[name] - of[f"{name}_cylinder.dead_length"]
               for name, (a, b) in ends.items()]
    return np.stack([*lengths, tip[0] * np.cos(swing), tip[0] * np.sin(swing), HEIGHT + tip[1]], axis=1)


def _rocker(of: Numbers, bucket: np.ndarray) -> np.ndarray:
    """Angle [rad] of the rocker in the stick's frame by Newton's method, along a way from the stated posture."""
    angle: np.ndarray = np.full(len(bucket), POSTURE["rocker"], dtype=np.result_type(bucket, *of.values()))
    for share in np.linspace(0, 1, STEPS + 1):
        turn = POSTURE["bucket"] + share * (bucket - POSTURE["bucket"])
        c, s = np.cos(turn), np.sin(turn)
        x = of["stick.a"] + c * of["bucket_linkage.x"] - s * of["bucket_linkage.y"] - of["rocker.pin.x"]
        y = s * of["bucket_linkage.x"] + c * of["bucket_linkage.y"] - of["rocker.pin.y"]
        for _ in range(ITERATIONS):
            dx, dy = x - of["rocker.a"] * np.cos(angle), y - of["rocker.a"] * np.sin(angle)
            gap = dx**2 + dy**2 - of["coupler.a"] ** 2
            angle = angle - gap / (2 * of["rocker.a"] * (dx * np.sin(angle) - dy * np.cos(angle)))
    return angle


def jacobians(numbers: dict[str, float], q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of `observed` by the numbers (N, 6, p) and by the joints (N, 6, 4)."""
    def slope(of: Callable[[], np.ndarray]) -> np.ndarray:
        return of().imag / STEP

    by_numbers = [slope(lambda name=name: observed(numbers | {name: numbers[name] + 1j * STEP}, q)) for name in numbers]
    by_joints = [slope(lambda k=k: observed(dict(numbers), q + 1j * STEP * np.eye(4)[k])) for k in range(4)]
    return np.stack(by_numbers, axis=2), np.stack(by_joints, axis=2)
