"""Imperfections that a machine in good order has, and faults that it has not."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from studies.verdicts.machines import Stated, Truth
from studies.verdicts.recording import Effects


@dataclass(frozen=True)
class Kind:
    """One kind of runs: what is not as a model has it, and how a fault is named."""

    effects: Effects = field(default_factory=Effects)
    stated: Stated = field(default_factory=Stated)
    named: tuple[str, ...] = ()
    """What the name of a fault begins with where it is named rightly."""
    fault: bool = False


SOUND: dict[str, Effects] = {
    "white": Effects(),
    "memory": Effects(memory=0.02),
    "bits_jitter": Effects(bits=12, jitter=5e-3),
    "stribeck": Effects(stribeck=0.6, presliding=5e-3),
    "load_friction": Effects(load_friction=0.03),
    "hose": Effects(hose=0.03),
    "warming": Effects(warming=-0.2),
    "soft_base": Effects(soft=np.radians(0.1)),
    "play": Effects(play=1e-3),
    "stick_slip": Effects(stick_slip=np.radians(0.3), stribeck=0.5, presliding=2e-3),
    "hose_stribeck_soft": Effects(hose=0.03, stribeck=0.6, presliding=5e-3, soft=np.radians(0.1)),
    "order": Effects(memory=0.01, bits=12, jitter=3e-3, stribeck=0.4, presliding=3e-3, load_friction=0.01, hose=0.01,
                     warming=-0.1, soft=np.radians(0.03), play=4e-4),
}
"""A machine in good order: steps, and all together in `order`."""
HONEST = {"stribeck": ("friction",), "load_friction": ("friction",), "hose": ("friction",), "warming": ("warming",),
          "soft_base": ("soft",), "play": ("play",), "stick_slip": ("friction",), "bits_jitter": (),
          "hose_stribeck_soft": ("friction", "soft"), "order": ("friction", "warming", "soft", "play")}
"""Names that are right of an imperfection."""
SIZES: dict[str, tuple[tuple[float, float, float], str]] = {
    "gain": ((0.01, 0.03, 0.1), "gain {pressure}"),
    "tilt": ((0.5, 1.5, 5.0), "tilt base"),
    "chamber_late": ((0.01, 0.04, 0.12), "delay {pressure}"),
    "delay": ((0.01, 0.04, 0.12), "delay forces"),
    "angle_late": ((0.01, 0.04, 0.12), "delay {joint}.q"),
    "clock": ((0.02, 0.08, 0.25), "clock forces"),
    "zero": ((0.3, 1.0, 3.0), "offset {joint}.q"),
    "load": ((0.04, 0.12, 0.35), "load {last}"),
    "drift": ((0.02, 0.06, 0.2), "drift {actuator}"),
    "warming_fault": ((0.3, 0.7, 1.4), "warming"),
    "quadratic": ((0.01, 0.03, 0.08), "friction {actuator}"),
    "bore": ((0.005, 0.015, 0.05), "gain {actuator}.p_"),
    "pin": ((0.005, 0.02, 0.08), "pin {actuator}"),
    "swap": ((1.0, 1.0, 1.0), "exchanged"),
}
"""Faults at three sizes (tilt and zero in degrees, pins in metres), and the names that are right of them."""
OTHER_FRICTION = (*(name for name in SOUND if name not in ("white", "memory", "bits_jitter")), "warming_fault",
                  "quadratic")
"""Kinds in which friction, as it is read, is another than the model's, so that its two numbers have no true value."""
DEGREES = ("tilt", "zero")
FIELDS = {"warming_fault": "warming"}


def applies(truth: Truth, fault: str) -> bool:
    """Whether a machine can have this fault."""
    return bool(truth.cylinders) or fault not in ("bore", "pin", "swap", "chamber_late")


def kind(truth: Truth, name: str, size: int = 0) -> Kind:
    """A kind by its name; of a fault one of three sizes."""
    if name in SOUND:
        return Kind(SOUND[name], named=HONEST.get(name, ()))
    sizes, words = SIZES[name]
    joint, actuator = truth.joints[truth.first].name, truth.actuators[truth.first]
    reading = f"{actuator}.p_head" if truth.cylinders else actuator
    word = words.format(joint=joint, actuator=actuator, pressure=reading, last=truth.joints[-1].name)
    value = np.radians(sizes[size]) if name in DEGREES else sizes[size]
    if name == "bore":
        return Kind(stated=Stated(bore={actuator: 1 + value}), named=(word,), fault=True)
    if name == "pin":
        return Kind(stated=Stated(rod_pin={actuator: (value, value / 2)}), named=(word,), fault=True)
    effects = Effects(swap=True) if name == "swap" else Effects(**{FIELDS.get(name, name): value})
    return Kind(effects, named=(word,), fault=True)
