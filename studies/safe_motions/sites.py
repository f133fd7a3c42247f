"""Random machines on random sites: drawn masses, uncertain chassis, slopes, footprints, obstacles, pumps and valves."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydroopt import Machine, load_machine
from hydroopt.excitation.motion.basis import Basis, Fourier, Spline
from hydroopt.machine.environment import Footprint, Obstacle, Pump
from hydroopt.machine.links import Note

BASES = ("cat215b", "cat215b", "cat215b", "tampere_manipulator", "tampere_manipulator", "knuckle_boom_crane")
STEEPEST = np.radians(6.0)


def random_site(rng: np.random.Generator) -> Machine:
    """A bundled machine with other masses on other ground."""
    machine = load_machine(str(rng.choice(BASES)))
    links = []
    for link in machine.links:
        body = link.body and link.body.model_copy(update={"m": link.body.m * float(rng.uniform(0.7, 1.4))})
        joint, change = link.joint, dict[str, Any]()
        if joint.moving and joint.independent and not joint.passive and rng.random() < 0.5:
            low, high = joint.range
            a, b = np.sort(rng.uniform(low, high, 2))
            change = {"lower": float(a), "upper": float(max(b, a + 0.3 * (high - low)))}
            change["upper"] = min(change["upper"], high)
        links.append(link.model_copy(update={"body": body, "joint": joint.model_copy(update=change)}))
    ground = machine.ground if machine.ground is not None else float(rng.uniform(-1.5, -0.3))
    weight = sum(link.body.m for link in links if link.body)
    length, width = rng.uniform(0.4, 1.5, 2)
    x, y = rng.uniform(-0.3, 0.3, 2)
    update: dict[str, Any] = {
        "links": tuple(links), "orientation": (*rng.uniform(-STEEPEST, STEEPEST, 2).tolist(), 0.0), "ground": ground,
        "workspace": None, "pump": Pump(max_flow=float(10 ** rng.uniform(-3.5, -2.3))) if rng.random() < 0.5 else None,
        "footprint": Footprint(corners=((x - length, y - width), (x + length, y - width), (x + length, y + width),
                                        (x - length, y + width)),
                               mass=float(weight * rng.uniform(0.3, 3)), com=(0.0, 0.0, ground + 0.5)),
        "obstacles": tuple(_obstacle(rng, k, ground) for k in range(rng.integers(0, 4))) + tuple(
            each for each in machine.obstacles if rng.random() < 0.7)}
    update["cylinders"] = tuple(
        each.model_copy(update={"relief_pressure": float(rng.uniform(1.2e7, 4e7))}) if rng.random() < 0.5 else each
        for each in machine.cylinders)
    off, aside = rng.uniform(0.0, 0.1), rng.uniform(0.0, 0.15)
    update["notes"] = machine.notes | {"footprint.mass": Note(sigma=float(off), relative=True),
                                       "footprint.com": Note(sigma=float(aside))}
    return machine.model_copy(update=update)


def _obstacle(rng: np.random.Generator, k: int, ground: float) -> Obstacle:
    around, away = rng.uniform(-np.pi, np.pi), rng.uniform(2, 8)
    return Obstacle(name=f"ball{k}", link="base", radius=float(rng.uniform(0.2, 1.2)), centre=(
        float(away * np.cos(around)), float(away * np.sin(around)), float(rng.uniform(ground, ground + 5))))


def random_basis(rng: np.random.Generator) -> Basis:
    """A short motion."""
    time = float(rng.uniform(4, 8))
    if rng.random() < 0.5:
        return Fourier(time, int(rng.integers(1, 4)), blend=float(rng.uniform(0.5, 2)))
    return Spline(time, int(rng.integers(3, 7)))
