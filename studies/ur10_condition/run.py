"""UR10, six joints, five harmonics: condition numbers of designed motions in the basis of the public tool figaroh."""

import math
import time

import numpy as np

from hydroopt import Model, load_machine
from hydroopt.excitation.criteria import DesignParameters, Information, design_parameters, presumed_noise
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.excitation.motion.design import design
from hydroopt.excitation.motion.excitation import Excitation
from hydroopt.excitation.motion.problem import ExcitationProblem
from hydroopt.limits.limits import Limits
from hydroopt.machine.actuators import TorqueFriction
from hydroopt.machine.machine import Machine

CENTRE = (0, -90, 90, -90, -90, 0)
REACH, SPEED_SHARE, TORQUE_SHARE, TORQUES = 1.2, 0.7, 0.8, (330, 330, 150, 54, 54, 54)
"""figaroh-examples, UR10 truth fixture v1 (identification_truth.py and manifest.json at 58c2bcf0): joints keep within
1.2 rad of a centre [deg], 0.7 of the greatest speed and 0.8 of the greatest torque [N·m]; 0.1 Hz, five harmonics."""
LENGTHS = {"shoulder_lift": {"a": -0.6127}, "elbow": {"a": -0.57155}, "shoulder_pan": {"d": 0.1807},
           "wrist_1": {"d": 0.17415}, "wrist_2": {"d": 0.11985}, "wrist_3": {"d": 0.11655}}
"""Its robot is a UR10e by its lengths [m]."""
DRAW = 18
"""The fixture's motion is the best of 20 random ones, of this seed."""
ALL = ("mc_x", "mc_y", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")
WRIST = ("mc_x", "mc_y", "I_xx", "I_xy", "I_xz", "I_yz")
PUBLISHED = {
    "shoulder_pan": ("I_zz",), "shoulder_lift": ALL, "elbow": ALL, "wrist_1": WRIST,
    "wrist_2": ("mc_x", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz"),
    "wrist_3": ("mc_x", "mc_y", "mc_z", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")}
"""The fixture's 36 columns (protocol.yaml at 9654134f); figaroh 1.0.2 takes I_xx for I_yy of the two upper links."""
SECONDS = 45.0


def columns(model: Model, later: bool = False) -> np.ndarray:
    """Places of figaroh's columns among our parameters."""
    swapped = {"shoulder_lift", "elbow"} if later else set()
    names = [f"{link}.{'I_xx' if link in swapped and element == 'I_yy' else element}"
             for link, elements in PUBLISHED.items() for element in elements]
    return np.array([model.parameters.names.index(name) for name in names])


def changed(machine: Machine, *, published: bool) -> Machine:
    """Without accelerations, which the comparison does not limit, and with the fixture's lengths and limits."""
    links = []
    for k, link in enumerate(machine.links):
        change: dict = {"max_acceleration": None}
        if published:
            middle = math.radians(CENTRE[k])
            change |= {"lower": middle - REACH, "upper": middle + REACH,
                       "max_speed": SPEED_SHARE * link.joint.max_speed, **LENGTHS[link.name]}
        links.append(link.model_copy(update={"joint": link.joint.model_copy(update=change)}))
    drives = machine.drives if not published else tuple(
        drive.model_copy(update={"max_torque": TORQUE_SHARE * most})
        for drive, most in zip(machine.drives, TORQUES, strict=True))
    drives = tuple(drive.model_copy(update={"friction": TorqueFriction()}) for drive in drives)
    return machine.model_copy(update={"links": tuple(links), "drives": drives})


def frozen() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The fixture's motion by its recipe: 1000 samples of (6,)."""
    rng, omega = np.random.RandomState(DRAW), 0.2 * np.pi * np.arange(1, 6)
    a, b = rng.uniform(-1, 1, (6, 5)), rng.uniform(-1, 1, (6, 5))
    t = np.arange(1000) / 100
    sin, cos = np.sin(np.outer(t, omega)), np.cos(np.outer(t, omega))
    q, qd = sin @ (a / omega).T - cos @ (b / omega).T, cos @ a.T + sin @ b.T
    qdd = cos @ (b * omega).T - sin @ (a * omega).T
    speed = SPEED_SHARE * np.array([2.0943951, 2.0943951, *[3.14159265] * 4])
    gain = np.minimum(REACH / np.abs(q).max(axis=0), speed / np.abs(qd).max(axis=0))
    return gain * q + np.radians(CENTRE), gain * qd, gain * qdd


def condition(model: Model, states, places) -> float:
    """Of the plain regressor in some columns."""
    K = model.over(model.regressor, *states)[0][:, :, places]
    return float(np.linalg.cond(K.reshape(-1, len(places))))


def designed(model: Model, asked: DesignParameters) -> tuple[Excitation, float]:
    program = ExcitationProblem(Information(model, asked, "condition"), Limits(model),
                                Fourier(10.0, 5), 100.0)
    began = time.perf_counter()
    found = design(program, processes=2, search_seconds=SECONDS)
    return found, time.perf_counter() - began


def run() -> dict:
    """Condition numbers in figaroh's two bases and in ours, times [s], and whether limits are kept."""
    results: dict = {}
    longest, room = 0.0, math.inf
    for case, published in (("own_limits", False), ("fixture_limits", True)):
        model = Model(changed(load_machine("ur10"), published=published))
        places = columns(model)
        own = design_parameters(model, presumed_noise(model))
        if published:
            motion = frozen()
            results["fixture"] = round(condition(model, motion, places), 3)
            results["fixture_columns_of_1_0_2"] = round(condition(model, motion, columns(model, later=True)), 3)
        unscaled = own._replace(scale=np.ones(len(places)), weight=np.ones(6))
        for basis, asked in (("figaroh", unscaled._replace(columns=places)), ("ours", unscaled)):
            found, seconds = designed(model, asked)
            path = found.trajectory
            states, name = (path.q, path.qd, path.qdd), f"{case}_designed_in_{basis}"
            periodic = [part[200:1200] for part in states]
            results[f"{name}_figaroh"] = round(condition(model, states, places), 2)
            results[f"{name}_figaroh_periodic_part"] = round(condition(model, periodic, places), 2)
            results[f"{name}_figaroh_1_0_2"] = round(condition(model, states, columns(model, later=True)), 2)
            results[f"{name}_ours"] = round(condition(model, states, own.columns), 2)
            weighted = Information(model, own, "condition").factor(*states, 1.0)
            results[f"{name}_ours_by_noise_and_confidence"] = round(float(np.linalg.cond(weighted)), 1)
            longest, room = max(longest, seconds), min(room, *(use.room for use in found.limits))
    return results | {"longest_s": round(longest, 1), "all_limits_kept": bool(room >= 0)}
