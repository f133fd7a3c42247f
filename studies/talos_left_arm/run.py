"""TALOS, torso and left arm, under motion capture: base and tip, joint offsets, lengths; each on unseen postures."""

import math
from pathlib import Path

import numpy as np

from hydroopt import calibration_problem, load_machine, read_poses, solve
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.estimation.kinematic.residuals import gaps
from hydroopt.machine.calibration_chain import Calibrator
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.sensors import Sensor
from hydroopt.machine.survey import Tracker

HERE = Path(__file__).parent
DATA = HERE.parents[2] / "shared" / "data" / "talos_left_arm"
POSES = DATA / "data" / "talos_left_arm_02_10_contact.csv"
CAPTURE = 0.5e-3
"""Standard deviation [m] of each coordinate of the marker; assumed, the data state none."""
OFFSET, LENGTH, ANGLE = math.radians(3), 1e-3, math.radians(0.1)
"""Standard deviations of joint offsets [rad], lengths [m] and axis directions [rad] before measuring; assumed."""
UNKNOWN = {"tracker.position": Note(sigma=1.0), "tracker.orientation": Note(sigma=0.5),
           "calibrator.tip": Note(sigma=0.2)}
FIRST, LAST = "torso_1_joint", "arm_left_7_joint"
UPPER_ARM, ELBOW, WRIST = "arm_left_3_joint", "arm_left_4_joint", "arm_left_6_joint"
SHEETS = (0.19, 0.345, 0.51)
"""Between the four sheets of the grid of postures [m], by the marker's x."""
SHIFT = 1.959964


def talos(offsets: bool = False, lengths: bool = False) -> Machine:
    """The URDF's arm with a marker on its last link and motion capture, and what is unknown about them."""
    arm = load_machine(DATA / "urdf" / "talos_full_v2.urdf", tip="arm_left_7_link")
    capture = Sensor(channels=("tip.x", "tip.y", "tip.z"), accuracy=CAPTURE, distribution="gaussian")
    notes = dict(UNKNOWN)
    for name in arm.joints:
        notes |= {f"{name}.joint.theta": Note(sigma=OFFSET)} if offsets else {}
        notes |= {f"{name}.joint.{key}": Note(sigma=sigma)
                  for key, sigma in (("d", LENGTH), ("a", LENGTH), ("alpha", ANGLE))} if lengths else {}
    return arm.model_copy(update={"calibrator": Calibrator(parent=LAST), "tracker": Tracker(), "sensors": (capture,),
                                  "notes": notes})


def judged(problem, theta) -> tuple[np.ndarray, object]:
    """Errors (N, 3) [m] of a problem's marker at the angles read, and its rows linearised there."""
    q = problem.angles(theta, problem.layout.reading)
    columns = [problem.model.channels.index(f"tip.{axis}") for axis in "xyz"]
    return gaps(problem, theta, q)[:, columns], linearise(problem, theta, q)


def left_out(problem, groups) -> tuple[np.ndarray, float]:
    """Errors (N, 3) [m] of every group when fitted to the others, and how many lie within the stated 95 % error."""
    errors, inside = np.zeros((len(problem.poses), 3)), []
    for there in groups:
        solved = solve(problem.without(there))
        errors[there], at = judged(problem.without(~there), solved.theta)
        slope = at.jacobian[:, :, problem.free]
        geometry = np.einsum("nik,kl,nil->ni", slope, solved.observability.covariance, slope)
        stated = max(1.0, solved.noise_scale) * np.sqrt(1 + geometry)  # in units of CAPTURE, as the residual
        inside.append(np.abs(at.residual) < SHIFT * stated)
    return errors, float(np.mean(np.concatenate(inside)))


def rms(errors) -> float:
    """Root of the mean squared length [mm] of the error vectors, over the postures."""
    return round(1e3 * float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))), 3)


def strongest(calibration) -> str:
    """The two parameters hardest to tell apart."""
    found = calibration.observability
    pairs = [(abs(found.strongest(k)[1]), name, *found.strongest(k)) for k, name in enumerate(found.names)]
    _, name, other, value = max(pair for pair in pairs if np.isfinite(pair[0]))
    return f"{name} and {other}: {value:.3f}"


def told(problem, solved, name: str) -> dict:
    """What becomes of the elbow, whose offset a wrong upper arm imitates, and of the wrist, which hardly moves."""
    change = dict(zip(problem.parameters.names, solved.theta - problem.parameters.nominal, strict=True))
    std = dict(zip(problem.parameters.names, solved.std, strict=True))
    found = {f"elbow_offset_deg_{name}": round(math.degrees(change[f"{ELBOW}.theta"]), 2),
             f"elbow_offset_std_deg_{name}": round(math.degrees(std[f"{ELBOW}.theta"]), 2),
             f"wrist_offset_std_deg_{name}": round(math.degrees(std[f"{WRIST}.theta"]), 2)}
    if f"{UPPER_ARM}.d" in change:  # its d is negative
        found |= {f"upper_arm_longer_{name}": round(-1e3 * change[f"{UPPER_ARM}.d"], 2),
                  f"upper_arm_longer_std_{name}": round(1e3 * std[f"{UPPER_ARM}.d"], 2)}
    return found


def run() -> dict | None:
    """RMS of the marker's error in mm, fitted and on postures left out; None where the data set is not at hand."""
    if not POSES.exists():
        return None
    poses = read_poses(POSES, mapping=HERE / "map.toml")
    everyone = np.arange(len(poses))
    alone = [everyone == k for k in everyone]
    sheet = np.digitize(poses.channels["tip.x"], SHEETS)
    sheets = [sheet == k for k in range(len(SHEETS) + 1)]
    nine = calibration_problem(talos(offsets=True), poses, priors=False)
    # an offset of the first joint is a turn of the tracker, one of the last a turn of the marker about that axis
    gauge = {f"{name}.theta": nine.start[nine.parameters.index(f"{name}.theta")] for name in (FIRST, LAST)}
    cases = {"base_and_tip": calibration_problem(talos(), poses, priors=False),
             "offsets": nine.fixing(**gauge),
             "lengths": calibration_problem(talos(offsets=True, lengths=True), poses)}
    results: dict = {"postures": len(poses)}
    for name, problem in cases.items():
        solved = solve(problem)
        one, covered = left_out(problem, alone)
        whole, covered_sheet = left_out(problem, sheets)
        results |= {f"rms_{name}": rms(judged(problem, solved.theta)[0]), f"leave_one_out_{name}": rms(one),
                    f"leave_sheet_out_{name}": rms(whole), f"errors_over_stated_{name}": round(solved.noise_scale, 2),
                    f"coverage_{name}": round(covered, 3), f"coverage_sheet_{name}": round(covered_sheet, 3),
                    f"suspects_{name}": [
                        f"{f'{s.kind} {s.name}'.strip()}: postures {poses.row[s.poses][0]} to {poses.row[s.poses][-1]}"
                        for s in solved.suspects],
                    f"strongest_correlation_{name}": strongest(solved)}
        if name == "offsets":
            seen = observability(nine, judged(nine, solved.theta)[1])
            results["unseen_combinations"] = sorted(list(names) for names in seen.combinations)
        results |= told(problem, solved, name) if name != "base_and_tip" else {}
    return results
