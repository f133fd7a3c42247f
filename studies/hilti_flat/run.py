"""Construction robot on a lifting column: offsets, geometry, compliance and tilt, scored at heights never fitted."""

import re
from pathlib import Path

import casadi as ca
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hydroopt import KinematicModel, Poses, calibration_problem, load_machine, solve
from hydroopt.estimation.kinematic.initial_guesses import follow_unsensed, guess_unsensed
from hydroopt.machine.actuators import Drive
from hydroopt.machine.calibration_chain import Calibrator, Stage
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.links import Joint, Link, Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.sensors import Accelerometer, Imu, Sensor
from hydroopt.machine.survey import Instrument, Tracker

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "hilti_flat"
ARM = tuple(f"dsr_joint{k}" for k in range(1, 7))
UNITS = {"base_tilt": "column", "column_tilt": "dsr_joint1_mount"}
"""Tilt sensors and the links that carry them."""
FELT = 1e-3
"""Standard deviation [m/s²] of an acceleration at a stop, 0.1 mrad of tilt: assumed."""
TILTS = ("lean_y", "lean_x", "bend_y", "bend_x")
PIVOT, FRONT = 2.0, 0.5
"""Guess [m] of how far the column's bend lies below its tip and before the base's origin."""
TRAIN = ((1.98, 3.22, 3.87), (2.72, 3.67))
"""Column heights [m] to fit; the others are scored."""
ITEM = re.compile(r"^  ([\d.]+):\n|^      (\d+):\n|^        (\w+)_measurements:|^        - id: (\d+)\n"
                  r"|^          (\w+): \[([^\]]*)\]", re.MULTILINE)


def read_points() -> dict[str, np.ndarray]:
    """What the YAML file holds of each of N stops, as arrays by key; `height`, `space` and `stationing` tell which."""
    rows: list[dict] = []
    for height, space, kind, number, key, values in ITEM.findall((DATA / "datasets" / "flat.yaml").read_text("utf-8")):
        if height:
            at_height = float(height)
        elif space:
            in_space = int(space)
        elif kind:
            stationing = kind == "stationing"
        elif number:
            rows.append({"height": at_height, "space": in_space, "stationing": stationing})
        elif rows:
            rows[-1][key] = [float(value) for value in values.split(",")]
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def surveyed(machine) -> Machine:
    """The machine as it is measured: a total station of unknown pose sees the prism, and units on base and column tip
    feel gravity; four joints of leaning and bending are not read."""
    geometry, levelled = Geometry(machine), {}
    for unit, link in UNITS.items():
        turn = np.array(ca.DM(geometry.relative_pose("base", link, {}).rotation @ np.eye(3))).T
        yaw, pitch, roll = Rotation.from_matrix(turn).as_euler("ZYX")
        levelled[unit] = (roll, pitch, yaw)
    felt = Accelerometer(noise=FELT, bias=1e-3)  # std of a reading is noise·√(rate/2)
    notes = {path: note for path, note in machine.notes.items() if not path.startswith(("tracker", "bend_"))}
    notes["column_tilt.orientation"] = Note(sigma=0.02)
    return Machine.model_validate(machine.model_dump() | {
        "tracker": None, "instruments": [Instrument(name="station")], "notes": notes,
        "imus": [Imu(name=unit, link=link, position=(0, 0, 0), rate=2.0, orientation=levelled[unit], accelerometer=felt)
                 for unit, link in UNITS.items()],
        "stages": [Stage(name="flat", moves=TILTS)],
        "sensors": [Sensor(channels=tuple(f"station.tip.{axis}" for axis in "xyz"), accuracy=0.75e-3,
                           distribution="gaussian")]})


def measured(points) -> Poses:
    """All stops with what was read: joints of arm and column, the prism, and accelerations of base and column's tip."""
    poses = table(points)
    channels = {name: values for name, values in poses.channels.items()
                if name.removesuffix(".q") not in TILTS and not name.startswith("tip")}
    channels |= {f"station.tip.{axis}": points["prism_position"][:, k] for k, axis in enumerate("xyz")}
    for unit, place in (("base_tilt", "base"), ("column_tilt", "column")):
        felt = points[f"tilt_sensor_{place}_accel"]
        channels |= {f"{unit}.accel_{axis}": felt[:, k] for k, axis in enumerate("xyz")}
    return Poses("flat", stage=np.full(len(poses), "flat"), channels=channels, units={"column.q": "m"})


def by_measured_tilt(points, use, **terms) -> tuple[np.ndarray, float]:
    """As `calibrated`, with the tilt sensors as measurements: of unseen poses they tell how base and column stand."""
    built, poses = surveyed(machine(tilt=True, **terms)), measured(points)
    found = solve(calibration_problem(built, poses.select(use)))
    felt = Poses("flat", stage=poses.stage, units={"column.q": "m"}, channels={
        name: values for name, values in poses.channels.items() if not name.startswith("station")})
    fresh = calibration_problem(built, felt)
    values = dict(zip(found.problem.parameters.names, found.theta.tolist(), strict=True))
    theta = np.array([values.get(name, start) for name, start in zip(fresh.parameters.names, fresh.start, strict=True)])
    q = follow_unsensed(fresh, theta, guess_unsensed(fresh, theta))
    return fresh.model.over(fresh.model.tip, theta[: len(fresh.model.parameters)], q)[0][:, :, 0], found.noise_scale


def tilts(points) -> dict[str, np.ndarray]:
    """Turns [rad] since the first stop: of the base about x and y, and of the column's tip against the base."""
    base, tip = (points[f"tilt_sensor_{place}_accel"] for place in ("base", "column"))
    base, tip = (a / np.linalg.norm(a, axis=1, keepdims=True) for a in (base, tip))
    turn = {"lean_x": base[:, 1], "lean_y": -base[:, 0], "bend_x": (tip - base)[:, 1], "bend_y": -(tip - base)[:, 0]}
    return {name: values - values[0] for name, values in turn.items()}


def machine(*, geometry=False, compliance=False, tilt=False):
    """Base that leans, column that rises and bends, arm, prism; the URDF's column has three joints for one motion.

    Args:
        geometry: whether all numbers of the arm are calibrated, or the offsets of its joints and the prism only.
        compliance: whether joints 1 to 3 give way to gravity, and the column too where no sensor says what it does.
        tilt: whether sensors say how base and column turn.
    """
    urdf = load_machine(DATA / "trailblazer.urdf", tip="prism")
    mount, *arm = urdf.links
    soft = [*ARM[:3], *(() if tilt else ("bend_y", "bend_x"))] if compliance else []
    quarter = np.pi / 2
    small = {"type": "revolute", "lower": -0.1, "upper": 0.1}
    column = Joint(type="prismatic", theta=quarter, a=FRONT, d=-PIVOT, alpha=-quarter, lower=1.48, upper=3.972)
    links = [  # z turns from up to y, β turns it on to x, the next α up again
        Link(name="foot", parent="base", joint=Joint(type="locked", alpha=-quarter)),
        Link(name="lean_y", parent="foot", joint=Joint(beta=quarter, **small)),
        Link(name="lean_x", parent="lean_y", joint=Joint(alpha=quarter, **small)),
        Link(name="column", parent="lean_x", joint=column),
        Link(name="bend_y", parent="column", joint=Joint(beta=quarter, **small)),
        Link(name="bend_x", parent="bend_y", joint=Joint(alpha=quarter, **small)),
        _changed(mount, parent="bend_x", theta=mount.joint.theta + quarter, d=mount.joint.d + PIVOT),
        _changed(arm[0], d=arm[0].joint.d - FRONT), *arm[1:]]
    links = [_changed(link, compliance=1e-5) if link.name in soft else link for link in links]
    sigma = {f"{name}.joint.theta": 0.02 for name in ARM[1:]}
    sigma |= {"dsr_joint6.joint.a": 0.01, "dsr_joint6.joint.d": 0.01}
    if geometry:  # without d of joint 1, as the tracker moves along, and of joint 3, which is parallel to joint 2
        sigma |= {f"{name}.joint.{key}": 0.02 if key == "alpha" else 0.01 for name in ARM[:5]
                  for key in ("a", "alpha", "d") if (name, key) not in (("dsr_joint1", "d"), ("dsr_joint3", "d"))}
        sigma |= {"dsr_joint2.joint.beta": 0.02, "bend_x.joint.theta": 0.02, "bend_y.joint.theta": 0.02}
    if tilt or compliance:  # where the column bends is not known at all
        sigma |= {f"{mount.name}.joint.d": 1.0, "dsr_joint1.joint.d": 0.3,
                  "bend_x.joint.theta": 0.02, "bend_y.joint.theta": 0.02}
    notes = {path: Note(sigma=value) for path, value in sigma.items()}
    notes |= {f"{name}.joint.compliance": Note(sigma=5e-5, lower=0.0) for name in soft}
    notes |= {"tracker.position": Note(sigma=10.0), "tracker.orientation": Note(sigma=1.0)}
    drives = tuple(Drive(name=f"{name}_drive", joint=name) for name in (*TILTS, "column"))
    return urdf.model_copy(update={
        "links": tuple(links), "drives": (*urdf.drives, *drives), "tracker": Tracker(), "notes": notes,
        "calibrator": Calibrator(parent="dsr_joint6"),
        "sensors": (Sensor(channels=("tip.x", "tip.y", "tip.z"), accuracy=0.75e-3, distribution="gaussian"),)})


def _changed(link, parent=None, **joint):
    return link.model_copy(update={"parent": parent or link.parent, "joint": link.joint.model_copy(update=joint)})


def table(points, *, tilt=False) -> Poses:
    """All stops as poses; without its sensors, base and column do not turn."""
    measured = tilts(points)
    q = {"column": points["joint_states"][:, 0]} | {name: measured[name] * tilt for name in TILTS}
    q |= {name: points["joint_states"][:, k + 1] for k, name in enumerate(ARM)}
    prism = {f"tip.{axis}": points["prism_position"][:, k] for k, axis in enumerate("xyz")}
    return Poses("flat", channels={f"{name}.q": values for name, values in q.items()} | prism, units={"column.q": "m"})


def prisms(model, geometry, poses) -> np.ndarray:
    """Prism (N, 3) [m] in the base frame by the readings."""
    q = np.stack([poses.channels[f"{joint}.q"] for joint in model.joints], axis=1)
    return model.over(model.tip, geometry[: len(model.parameters)], q)[0][:, :, 0]


def kabsch(points, seen) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and shift (3,) [m] that bring points (N, 3) best onto those seen."""
    u, _, vt = np.linalg.svd((points - points.mean(axis=0)).T @ (seen - seen.mean(axis=0)))
    rotation = (u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt).T
    return rotation, seen.mean(axis=0) - rotation @ points.mean(axis=0)


def stations(points) -> list[tuple[np.ndarray, np.ndarray]]:
    """Masks of the stationing points and of the evaluation points that go with them.

    A station is a height and a solution space. The upside-down poses, space 4, have no stationing points: they go with
    all those of their height.
    """
    height, space, known = points["height"], points["space"], points["stationing"]
    return [((height == at) & known & np.isin(space, on), (height == at) & ~known & (space == which))
            for at in np.unique(height) for which, on in ((0, [0]), (7, [7]), (4, [0, 7]))]


def errors(tip, points) -> np.ndarray:
    """Distance [mm] between each evaluation point and where its station sees the prism; NaN at stationing points."""
    seen, error = points["prism_position"], np.full(len(tip), np.nan)
    for known, asked in stations(points):
        rotation, shift = kabsch(tip[known], seen[known])
        error[asked] = 1e3 * np.linalg.norm(tip[asked] @ rotation.T + shift - seen[asked], axis=1)
    return error


def station_offsets(points, use) -> np.ndarray:
    """Prisms (N, 3) [m] with offsets of joints 2 to 5 and the prism for which every station's own pose fits best.

    The station of space 0 takes the upside-down poses along, without which nothing tells the prism's height.
    """
    poses, model = table(points), KinematicModel(machine())
    free = np.array([not name.startswith("tracker") for name in model.parameters.names])
    seen, height, turned = points["prism_position"], points["height"], points["space"] == 7

    def tip(x):
        geometry = model.parameters.nominal.copy()
        geometry[free] += x * model.parameters.scale[free]
        return prisms(model, geometry, poses)

    def left(x):
        found, gaps = tip(x), []
        for group in (use & (height == at) & (turned == side) for at in np.unique(height[use]) for side in (0, 1)):
            rotation, shift = kabsch(found[group], seen[group])
            gaps.append(found[group] @ rotation.T + shift - seen[group])
        return np.concatenate(gaps).ravel()

    return tip(least_squares(left, np.zeros(free.sum())).x)


def calibrated(points, use, **terms) -> tuple[np.ndarray, float]:
    """Prisms (N, 3) [m] by the library's calibration to some of the poses, and how their errors compare with 0.75 mm.

    The robot stood still throughout, so that the total station is one tracker for all stations.
    """
    poses, built = table(points, tilt=terms.get("tilt", False)), machine(**terms)
    model = KinematicModel(built)
    tip = prisms(model, model.parameters.nominal, poses)
    rotation, shift = kabsch(points["prism_position"][use], tip[use])
    turn = (np.arctan2(rotation[2, 1], rotation[2, 2]), -np.arcsin(rotation[2, 0]),
            np.arctan2(rotation[1, 0], rotation[0, 0]))
    built = built.model_copy(update={"tracker": Tracker(position=tuple(shift), orientation=turn)})
    found = solve(calibration_problem(built, poses.select(use)))
    return prisms(found.problem.model, found.theta, poses), found.noise_scale


ROWS = {"offsets_compliance": {"compliance": True}, "offsets_tilt": {"tilt": True},
        "offsets_both": {"compliance": True, "tilt": True}, "geometry": {"geometry": True},
        "geometry_tilt": {"geometry": True, "tilt": True},
        "geometry_both": {"geometry": True, "compliance": True, "tilt": True}}

MEASURED = {"offsets_measured": {"compliance": True}, "geometry_measured": {"geometry": True, "compliance": True}}
"""Terms of the rows whose tilt sensors are measurements."""


def run() -> dict | None:
    """Mean errors of predicted prisms in mm; None where the data set is not at hand."""
    if not DATA.exists():
        return None
    points = read_points()
    own = points["space"] != 4
    model = KinematicModel(machine())
    everything = np.ones(len(own), dtype=bool)
    results: dict = {"poses": len(own)}
    for name, tip in (("nominal", prisms(model, model.parameters.nominal, table(points))),
                      ("offsets_all_data", station_offsets(points, everything))):
        error = errors(tip, points)
        results |= {name: _mean(error[own]), f"{name}_with_upside_down": _mean(error)}
    folds = [np.isin(points["height"], heights) for heights in TRAIN]
    fits = {"offsets": [(station_offsets(points, fold), np.nan) for fold in folds]}
    fits |= {name: [calibrated(points, fold, **terms) for fold in folds] for name, terms in ROWS.items()}
    fits |= {name: [by_measured_tilt(points, fold, **terms) for fold in folds] for name, terms in MEASURED.items()}
    for name, pair in fits.items():
        error = [errors(tip, points) for tip, _ in pair]
        fitted, unseen = np.full(len(own), np.nan), np.full(len(own), np.nan)
        for fold, found in zip(folds, error, strict=True):
            fitted[fold], unseen[~fold] = found[fold], found[~fold]
        results |= {f"{name}_in_sample": _mean(fitted[own]), f"{name}_held_out": _mean(unseen[own]),
                    f"{name}_held_out_with_upside_down": _mean(unseen)}
    results["geometry_both_held_out_worst_height"] = max(_mean(unseen[own & (points["height"] == at)])
                                                         for at in np.unique(points["height"]))
    results["geometry_both_held_out_worst_point"] = round(float(np.nanmax(unseen)), 2)
    results["geometry_both_noise_scale"] = round(max(scale for _, scale in fits["geometry_both"]), 2)
    return results


def _mean(error) -> float:
    return round(float(np.nanmean(error)), 3)
