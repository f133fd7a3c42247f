"""A small arm, and its logs as sensors with noise in the torque alone see them."""

from __future__ import annotations

import numpy as np

from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Fourier
from hydroopt.machine.components import Note
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate

PERIOD, RATE = 10.0, 20.0
PERIODIC = Fourier(period=PERIOD, harmonics=6)
"""Exact for the motions made here."""
TORQUE_NOISE = 0.5


def _link(name: str, parent: str, mass: float, **joint: float) -> dict:
    return {"name": name, "parent": parent,
            "joint": {"type": "revolute", "a": 1.0, "lower": -2.0, "upper": 2.0, "max_speed": 3.0, **joint},
            "body": {"m": mass, "com": (0.4, 0.1, 0.0), "inertia_com": (0.1, 0.0, 0.0, 0.3, 0.0, 0.3)}}


def _arm(*links: dict) -> Model:
    notes = {f"{link['name']}.body.{key}": Note(sigma=0.3, relative=True)
             for link in links for key in ("m", "com", "inertia_com")}
    drives = [{"name": f"{link['name']}_drive", "joint": link["name"],
               "friction": {"offset": 0.0, "coulomb": 4.0, "viscous": 2.0}}
              for link in links if link["joint"]["type"] == "revolute"]
    return Model(Machine.model_validate({"name": "arm", "orientation": (np.pi / 2, 0.0, 0.0), "links": list(links),
                                         "drives": drives, "notes": notes}))


PLANAR = _arm(_link("upper", "base", 5.0), _link("fore", "upper", 3.0))
"""Two links in a vertical plane: nothing tells where a load lies across it."""
SPATIAL = _arm(_link("post", "base", 8.0, alpha=np.pi / 2), _link("upper", "post", 5.0), _link("fore", "upper", 3.0))
"""The same arm on a post that lies down, so that the plane turns."""
GRIPPING = _arm(_link("post", "base", 8.0, alpha=np.pi / 2), _link("upper", "post", 5.0), _link("fore", "upper", 3.0),
                {"name": "grip", "parent": "fore", "joint": {"type": "locked", "theta": 0.3, "d": 0.1}})
"""Holds loads in a grip without a body of its own."""


def recorded(model: Model, psi: np.ndarray, seed: int, noise: float = 0.0, *, scale: float = 1.0) -> Log:
    """A log of a random motion, whose torques are misread by `scale` and noise."""
    motion = random_trajectory(model, duration=PERIOD, rate=RATE, seed=seed, slowest=0.1, fastest=0.5)
    log = simulate(model, motion, psi, noise=False, name=f"motion {seed}")
    rng = np.random.default_rng(seed)
    channels = {name: values * scale + noise * rng.standard_normal(values.shape) if name.endswith(".tau") else values
                for name, values in log.channels.items()}
    return Log(log.name, log.t, channels, units=log.units)


def with_load(model: Model, m: float, com: np.ndarray, link: str) -> np.ndarray:
    """Nominal parameters and a solid ball of 5 cm on a link, written out by hand."""
    x, y, z = com
    i = 0.4 * m * 0.05**2
    psi = model.parameters.nominal.copy()
    k = model.parameters.index(f"{link}.m")
    psi[k : k + 10] += [m, m * x, m * y, m * z, i + m * (y * y + z * z), -m * x * y, -m * x * z,
                        i + m * (x * x + z * z), -m * y * z, i + m * (x * x + y * y)]
    return psi
