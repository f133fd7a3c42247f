"""What there is to know of a machine before any log: geometry over its range, parameters, what can be determined."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hydroopt.estimation.inference import identifiability
from hydroopt.estimation.kinematic.mobility import mobility
from hydroopt.estimation.motion.sensor_calibration import DURATION, NAME, expected_calibration
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loops import Coupling
from hydroopt.machine.machine import Machine
from hydroopt.machine.range_checks import LoopRange, Span, loop_ranges, other_ways, over_range, spans
from hydroopt.model.model import recent_model
from hydroopt.parameters import hydraulic as hydraulic_parameters
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.results.machine_diagnostics import machine_diagnostics
from hydroopt.simulation.simulate import Trajectory

DETERMINED = {"full": "yes", "combination": "partly", "none": "hardly"}
"""Whether a motion determines a number, by its identifiability."""


def machine_facts(machine: Machine, motion: Trajectory | None = None) -> dict[str, Any]:
    """Joints, cylinders, channels, sensors, parameters, identifiability and mobility, ready for JSON.

    Of IMUs what a `motion` tells, by default a random one.
    """
    model = recent_model(machine)
    found = identifiability.structural(model)
    cylinders = [_cylinder_facts(machine, each) for each in machine.cylinders]
    parameters = [row | {"identifiability": category}
                  for row, category in zip(_parameter_facts(model.parameters), found.category, strict=True)]
    sensors = [{"channel": channel, "unit": machine.channel_units[channel], "std": sensor.std, "rate_hz": sensor.rate}
               for sensor in machine.sensors for channel in sensor.channels]
    freedom = mobility(machine)
    return {"machine": {"name": machine.name, "parameter_set": machine.parameter_set, "sha256": machine.sha256,
                         "description": machine.description},
             "joints": [_joint_facts(machine, name) for name in machine.joints], "cylinders": cylinders,
             "linkages": _linkages(machine),
             "spans": [_span_facts(each) for each in spans(machine)],
             "couplings": [_coupling_facts(machine, each) for each in machine.couplings],
             "channels": machine.channel_units, "sensors": sensors, "parameters": parameters,
             "hydraulic_parameters": _parameter_facts(hydraulic_parameters.parameter_set(machine)),
             "identifiability": {"rank": found.rank, "full": found.count("full"),
                                 "combination": found.count("combination"), "none": found.count("none")},
            "calibration": freedom.as_dict() | {"lines": freedom.lines()},
            "imus": _imu_facts(machine, motion) if machine.imus else None,
            "diagnostics": [each.as_dict() for each in machine_diagnostics(model)]}


def _imu_facts(machine: Machine, motion: Trajectory | None) -> dict[str, Any]:
    """How well a motion determines where units sit, their biases and the joints' positions: standard deviations."""
    found = expected_calibration(machine, motion)
    numbers = [{"name": each.name.replace(f"{NAME}: ", "bias of "), "unit": each.unit, "stated_std": each.prior_std,
                "expected_std": each.std, "determined": DETERMINED[each.identifiability]}
               for each in found.parameters.values()]
    spread = {joint: float(np.sqrt(np.mean(np.concatenate([one[f"{joint}.q_std"] for one in found.motions]) ** 2)))
              for joint in machine.joints}
    return {"motion": f"a random motion of {DURATION:g} s" if motion is None else "the given motion",
            "numbers": numbers,
            "joints": [{"joint": joint, "unit": machine.position_unit(joint), "std": std, "range": float(np.ptp(
                machine.link(joint).joint.range))} for joint, std in spread.items()]}


def _parameter_facts(parameters: ParameterSet) -> list[dict[str, Any]]:
    known = parameters.information.diagonal() > 0
    return [{"name": name, "unit": unit, "nominal": float(value), "prior_std": float(scale) if prior else None}
            for name, unit, value, scale, prior in zip(
                parameters.names, parameters.units, parameters.nominal, parameters.scale, known, strict=True)]


def _joint_facts(machine: Machine, name: str) -> dict[str, Any]:
    joint = machine.link(name).joint
    turn = joint.type == "revolute"
    unit, factor = ("deg", 180 / math.pi) if turn else ("m", 1.0)
    drivers = ", ".join(each.name if each.measured else f"{each.name} (not measured)"
                        for each in machine.drivers[name]) or "passive"
    if name in machine.base_joints:
        drivers = "the ground"
    elif together := _together(machine, name):
        drivers = f"{together} together"
    return {"joint": name, "type": joint.type, "actuator": drivers, "unit": unit,
            "lower": round(factor * (joint.lower or 0.0), 4), "upper": round(factor * (joint.upper or 0.0), 4)}


def _linkages(machine: Machine) -> list[dict[str, Any]]:
    ways = other_ways(machine)
    return [facts | {"assembly": ways.get(facts["linkage"], "")}
            for facts in (_linkage_facts(machine, each) for each in loop_ranges(machine))]


def _linkage_facts(machine: Machine, loop: LoopRange) -> dict[str, Any]:
    """What follows what, its transmission ratio over the range, and the margin to a dead point."""
    closure, last = loop.assembly.closure, loop.assembly.closure.follows[-1]
    ratios = [{"ratio": f"{joint} / {last}", "min": round(least, 4), "max": round(greatest, 4),
               "unit": machine.ratio_unit(joint, last)} for joint, (least, greatest) in loop.ratios.items()]
    return {"linkage": ", ".join(each.name for each in closure.statements), "follows": ", ".join(closure.follows),
            "dependent": ", ".join(closure.joints), "ratios": ratios, "margin_deg": round(math.degrees(loop.angle), 2),
            "margin_at": loop.at}


def _coupling_facts(machine: Machine, coupling: Coupling) -> dict[str, Any]:
    """A linear relation of joints, in words with its units."""
    terms = [f"{ratio:.6g}{'' if (unit := machine.ratio_unit(coupling.joint, joint)) == '1' else f' {unit}'} * {joint}"
             for joint, ratio in coupling.ratios.items()]
    offset = [f"{math.degrees(coupling.offset):.6g} deg" if machine.turns(coupling.joint)
              else f"{coupling.offset:.6g} m"] * (coupling.offset != 0)
    return {"coupling": coupling.name, "relation": f"{coupling.joint} = {' + '.join((*terms, *offset))}"}


def _together(machine: Machine, joint: str) -> int:
    """How many cylinders only together move a joint and as many others; 0 if none do."""
    return next((len(group) for group in machine.entangled if joint in group), 0)


def _span_facts(span: Span) -> dict[str, Any]:
    """Joints that only several cylinders together move, and the margin to a singular posture."""
    return {"cylinders": ", ".join(each.name for each in span.cylinders), "joints": ", ".join(span.joints),
            "margin_deg": round(math.degrees(span.angle), 2), "margin_at": span.at}


def _cylinder_facts(machine: Machine, cylinder: Cylinder) -> dict[str, Any]:
    """Areas, and length and lever arm over the ranges of all joints that move its pins."""
    joint = machine.main_joint(cylinder)
    lengths, arms, _ = over_range(Geometry(machine), cylinder)
    head, rod = cylinder.areas
    moves = f"{joint} and others" if _together(machine, joint) else joint
    return {"cylinder": cylinder.name, "joint": moves, "head_area_cm2": round(1e4 * head, 3),
            "rod_area_cm2": round(1e4 * rod, 3), "length_min_m": round(float(lengths.min()), 4),
            "length_max_m": round(float(lengths.max()), 4), "lever_arm_min_m": round(float(arms.min()), 4),
            "lever_arm_max_m": round(float(arms.max()), 4)}
