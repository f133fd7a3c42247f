"""Every kind of input: how a spoilt one is made, and which public reader gets it."""

from __future__ import annotations

import contextlib
import io
import json
import math
import random
import tempfile
from collections.abc import Callable
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from fixtures.bad_input_cases import DIGGER
from fuzzing import mutation
from hydroopt.cli.new import _read as read_answers
from hydroopt.cli.options import smoothing_of, treatment_of
from hydroopt.codegen import parameter_source
from hydroopt.control.setting import nominal_of, truth
from hydroopt.errors import LONGEST, HydrooptError
from hydroopt.estimation.dynamic.stored_information import stored_information
from hydroopt.logs.column_headers import map_of_header
from hydroopt.logs.column_map import LogMap, read_map
from hydroopt.logs.formats.process import serve
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log
from hydroopt.logs.poses import read_poses
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import bundled, dump_machine, load_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.results.answer import load
from hydroopt.simulation.pose_table import simulate_poses
from hydroopt.simulation.reference_motion import reference_motion
from hydroopt.units import to_si

MODELS = Path(__file__).parents[2] / "models"
ARM = "patu655_lift"
RIG = str(Path(__file__).parents[2] / "docs/how-to/measure_up.toml")
"""A machine whose geometry is measured by hand."""

URDF = """<?xml version="1.0"?>
<robot name="arm"><link name="ground"/>
  <link name="boom"><inertial><origin xyz="0.5 0 0.1" rpy="0 0.1 0"/><mass value="12.5"/>
    <inertia ixx="0.1" ixy="0.01" ixz="0" iyy="1.2" iyz="0" izz="1.3"/></inertial></link>
  <link name="stick"/><link name="tool"/>
  <joint name="lift" type="revolute"><parent link="ground"/><child link="boom"/><origin xyz="0 0 1" rpy="0 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="tilt" type="continuous"><parent link="boom"/><child link="stick"/><origin xyz="1 0 0"/>
    <axis xyz="0 1 0.1"/></joint>
  <joint name="mount" type="fixed"><parent link="stick"/><child link="tool"/><origin rpy="0 0 1.57"/></joint>
</robot>
"""
MAP = """format = "csv"
delimiter = ";"
decimal = ","
rows = [2, 30]
[columns]
t = { column = "time", unit = "ms" }
"lift.q" = { column = 1, minus = "zero", unit = "deg", factor = -1.0, offset = "90 deg" }
"lift_cylinder.p_head" = { column = "head pressure", unit = "bar" }
"a.p_rod" = { variable = "data.rod", row = 2, unit = "psi" }
[labels]
stage = "low {file}"
pose = { column = "point" }
"""
POSES = "stage,fixture,pose,t [s],boom.q [deg],boom_cylinder.length [mm],tip.x [m]\n" + "".join(
    f"low,hole 1,p{k},{k},{10 * k},{1600 + k},{k / 7:.5f}\n" for k in range(9))


@cache
def arm() -> Machine:
    return load_machine(ARM)


@cache
def model() -> Model:
    return Model(arm())


@cache
def motion() -> dict[str, np.ndarray]:
    """A short motion of the crane with all that its sensors read."""
    t = np.arange(120) * 0.05
    q = 0.3 + 0.1 * np.sin(2 * t)
    return {"t [s]": t, "lift.q [rad]": q, "lift_cylinder.p_head [Pa]": 1e7 + 1e6 * q,
            "lift_cylinder.p_rod [Pa]": 1e6 + 0 * q, "remark": 0 * t}


@cache
def log_text() -> str:
    columns = motion()
    rows = zip(*(columns[name] for name in columns), strict=True)
    return ",".join(columns) + "\n" + "\n".join(",".join(f"{cell:.6g}" for cell in row) for row in rows) + "\n"


@cache
def sheet_text() -> str:
    """A table of poses of the excavator that is measured up, as filled in on the site."""
    machine = load_machine(RIG)
    rows = "".join(f",,{k},{0.3 * k - 1.2},{0.2 - 0.06 * k},{-1.5 + 0.1 * k},{-0.3 - 0.1 * k}\n" for k in range(8))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "postures.csv"
        file.write_text("stage,fixture,pose,swing.q [rad],boom.q [rad],stick.q [rad],bucket.q [rad]\n" + rows, "utf-8")
        found = simulate_poses(KinematicModel(machine), read_poses(file), seed=1)
    return found.poses.encoded(parquet=False).decode()


ANSWERS = """kind = "excavator"
"name" = "digger"
"swing.height" = "28 in"
"boom.length" = "6235 mm"
"boom_cylinder.barrel_up" = "-22,5 cm"
"boom.extends" = "up"
"boom_cylinder.bore" = "13 cm"
"boom_cylinder.jacks" = "2"
"stick.length" = "3 m"
"stick.mass" = ""
"bucket.mass" = "700 kg"
"""


@cache
def machine_texts() -> tuple[str, ...]:
    return (DIGGER, DIGGER, *((MODELS / f"{name}.toml").read_text("utf-8") for name in bundled()))


def estimate_of(machine: Machine) -> dict[str, Any]:
    """The JSON file of an identification of the crane, as `hydroopt identify` writes it."""
    names = Model(machine).parameters.names
    row = {"kind": "mass", "unit": "kg", "nominal": 1.0, "prior_std": None, "value": 2.0, "std": 0.1,
           "ci95": [1.8, 2.2], "bound": None, "identifiability": "full", "information_from_data": 1.0}
    return {"schema": 3, "job": "identification",
            "machine": {"name": machine.name, "parameter_set": machine.parameter_set, "sha256": machine.sha256},
            "created": "2026-01-01T00:00:00+00:00", "method": "sdp", "versions": {"hydroopt": "0.1.0"}, "status": "ok",
            "inputs": [{"path": "log.csv", "sha256": "0" * 64, "samples": 40, "first_sample": 1, "last_sample": 40,
                        "role": "train"}],
            "findings": [], "diagnostics": [
                {"kind": "validation forces predicted worse than by zero", "subject": ["lift_cylinder"],
                 "evidence": {"relative": 1.3}, "text": "", "remedy": ""}],
            "parameters": [row | {"name": name} for name in names],
            "fit": {"train": {"lift_cylinder": {"rms": 10.0, "vaf": 0.9, "relative": 0.1, "unit": "N"}}},
            "weights": {part.name: {"sigma": 10.0, "correlation_time": 2.0, "samples": 40}
                        for part in machine.actuators}, "wall_s": 1.0}


@cache
def estimate() -> tuple[dict[str, Any], str, str]:
    """JSON file, information.csv and machine file of an estimate."""
    names = model().parameters.names
    size = len(names) + 1
    triangle = "\n".join(",".join(["lift_cylinder", *(str(float(k == j)) for j in range(size))]) for k in range(size))
    information = ",".join(["actuator", *names, "force"]) + "\n" + triangle + "\n"
    return estimate_of(arm()), information, dump_machine(arm())


def _machine(rng: random.Random, folder: Path) -> Callable[[], object]:
    file = folder / "machine.toml"
    file.write_bytes(mutation.text(rng, rng.choice(machine_texts())))
    return lambda: load_machine(file)


def _urdf(rng: random.Random, folder: Path) -> Callable[[], object]:
    file = folder / "arm.urdf"
    file.write_bytes(mutation.text(rng, URDF))
    return lambda: load_machine(file)


def _csv(rng: random.Random, folder: Path) -> Callable[[], object]:
    file = folder / "log.csv"
    file.write_bytes(mutation.text(rng, log_text()))
    return lambda: read_log(file)


def _parquet(rng: random.Random, folder: Path) -> Callable[[], object]:
    file = folder / "log.parquet"
    file.write_bytes(mutation.parquet(rng, motion()))
    return lambda: read_log(file)


LAYOUT = {"columns": {"t": {"variable": "t", "unit": "s"}, "lift.q": {"variable": "q", "unit": "rad"},
                      "lift_cylinder.p_head": {"variable": "s.p", "unit": "Pa"}}}


def matlab_bytes(rng: random.Random) -> bytes:
    columns = motion()
    return mutation.matlab(rng, {"t": columns["t [s]"], "q": columns["lift.q [rad]"]} | (
        {"s": columns["lift_cylinder.p_head [Pa]"]} if rng.random() < 0.2 else {}))


def _matlab(rng: random.Random, folder: Path) -> Callable[[], object]:
    """What SciPy's process does, without the process: a crash here is one that it contains."""
    file = folder / "log.mat"
    file.write_bytes(matlab_bytes(rng))
    return lambda: serve("mat", file, io.BytesIO(b'{"sheet": 0, "columns": [0], "stamps": false}\n'), io.BytesIO())


def _matlab_process(rng: random.Random, folder: Path) -> Callable[[], object]:
    file = folder / "log.mat"
    file.write_bytes(matlab_bytes(rng))
    layout = LogMap.model_validate({"columns": {key: LAYOUT["columns"][key] for key in ("t", "lift.q")}})
    return lambda: read_log(file, mapping=layout)


def _map(rng: random.Random, folder: Path) -> Callable[[], object]:
    file = folder / "map.toml"
    file.write_bytes(mutation.text(rng, MAP))
    poses = rng.random() < 0.5
    log = folder / "log.csv"
    log.write_text(log_text(), "utf-8")
    return lambda: (read_map(file, poses=True) if poses else read_log(log, mapping=file))


def _poses(rng: random.Random, folder: Path) -> Callable[[], object]:
    file = folder / "poses.csv"
    file.write_bytes(mutation.text(rng, POSES))
    return lambda: read_poses(file)


def _sheet(rng: random.Random, folder: Path) -> Callable[[], object]:
    file = folder / "sheet.csv"
    file.write_bytes(mutation.text(rng, sheet_text()))
    return lambda: read_poses(file)


def _answers(rng: random.Random, folder: Path) -> Callable[[], object]:
    file = folder / "answers.toml"
    file.write_bytes(mutation.text(rng, ANSWERS))
    return lambda: read_answers(file)


def _rig(rng: random.Random, folder: Path) -> Callable[[], object]:
    file = folder / "rig.toml"
    file.write_bytes(mutation.text(rng, Path(RIG).read_text("utf-8")))
    return lambda: load_machine(file)


def _truth(rng: random.Random, folder: Path) -> Callable[[], object]:
    file, plant = folder / "truth.json", _plant()
    psi = dict(zip(plant.model.parameters.names, plant.model.parameters.nominal.tolist(), strict=True))
    file.write_bytes(mutation.tree(rng, {"machine": ARM, "sha256": "0", "seed": 1, "noise": True, "parameters": psi}))
    return lambda: truth(str(file), plant, seed=0)


@lru_cache
def _plant() -> Plant:
    return Plant(model())


def _trajectory(rng: random.Random, folder: Path) -> Callable[[], object]:
    file = folder / "path.csv"
    columns = motion()
    q = columns["lift.q [rad]"]
    good = {"t [s]": columns["t [s]"], "lift.q [rad]": q, "lift.qd [rad/s]": np.gradient(q),
            "lift.qdd [rad/s^2]": 0 * q}
    changed = mutation.columns(rng, good) if rng.random() < 0.6 else good
    rows = zip(*(changed[name] for name in changed), strict=True)
    text = ",".join(changed) + "\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n"
    file.write_bytes(text.encode("utf-8", "replace") if changed is not good else mutation.text(rng, text))
    return lambda: reference_motion(arm(), read_log(file))


def _estimate(rng: random.Random, folder: Path) -> Callable[[], object]:
    content, information, machine = estimate()
    which = rng.choice(("json", "json", "json", "json", "information", "machine"))
    beside = {"information.csv": mutation.text(rng, information) if which == "information" else information.encode(),
              f"{ARM}.toml": mutation.text(rng, machine) if which == "machine" else machine.encode()}
    for name, data in beside.items():
        (folder / name).write_bytes(data)
    content = content | {"files": {name: sha256(data).hexdigest() for name, data in beside.items()}}
    (folder / "estimate.json").write_bytes(mutation.tree(rng, content) if which == "json" else
                                           json.dumps(content).encode())

    def read() -> None:
        answer = load(folder)
        for use in (str, repr, lambda found: found.to_frame(), lambda found: dict(found.files()),
                    lambda found: [found[name] for name in found.parameters],
                    lambda found: found.parameters.to_csv(), lambda found: found.machine):
            with contextlib.suppress(HydrooptError):
                use(answer)
        for job in (lambda: parameter_source.read(str(folder)), lambda: stored_information(model(), folder),
                    lambda: nominal_of(folder, model())):
            with contextlib.suppress(HydrooptError):
                job()
    return read


def _option(rng: random.Random, folder: Path) -> Callable[[], object]:
    word = rng.choice((*mutation.NUMBERS, *mutation.WORDS))
    other = rng.choice((*mutation.NUMBERS, *mutation.WORDS))
    return rng.choice((
        lambda: to_si(f"{word} {other}", rng.choice(("m", "rad", "1", "Pa", "N*m*s/rad")), where="--fix"),
        lambda: to_si(word, "rad", where="--rest"),
        lambda: smoothing_of(rng.choice(("fourier:", "butterworth:", "spline:")) + f"{word}:{other}", None, arm()),
        lambda: smoothing_of(f"butterworth:{word}", None, arm()),
        lambda: treatment_of([f"{word}={other}"]),
        lambda: map_of_header(["t [s]", f"{word}.q [{other}]", word], "log.csv", poses=rng.random() < 0.5),
        lambda: Log("made", [0.0, 1.0], {f"{word}.q": [0.0, 1.0]}, units={f"{word}.q": other}),
        lambda: load_machine(word), lambda: load_machine(ARM, parameter_set=word),
        lambda: read_log(word), lambda: load(word), lambda: parameter_source.read(word)))


Spoil = Callable[[random.Random, Path], Callable[[], object]]
KINDS: dict[str, tuple[Spoil, float]] = {
    "machine file": (_machine, 0.13), "URDF": (_urdf, 0.10), "CSV log": (_csv, 0.13), "Parquet log": (_parquet, 0.1),
    "MATLAB content": (_matlab, 0.08), "column map": (_map, 0.1), "pose table": (_poses, 0.12), "truth": (_truth, 0.06),
    "trajectory": (_trajectory, 0.05), "estimate folder": (_estimate, 0.04), "option value": (_option, 0.0385),
    "filled sheet": (_sheet, 0.02), "answers": (_answers, 0.02), "rig": (_rig, 0.01),
    "MATLAB file": (_matlab_process, 0.0015)}
"""By name: what makes a spoilt input of the kind and the reader that gets it, and the kind's part of all inputs."""
CONTAINED = "MATLAB content"
"""The kind whose crashes a process contains."""


def parse(kind: str, seed: int) -> str:
    """"value" or the sentence of the refusal; anything else that a reader does is raised."""
    rng = random.Random(f"{kind} {seed}")
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        read = KINDS[kind][0](rng, Path(folder))
        shown = io.StringIO()
        with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(shown):
            try:
                read()
            except HydrooptError as error:
                return judged(str(error))
        if shown.getvalue():
            raise AssertionError(f"prints {shown.getvalue()[:100]!r}")
    return "value"


def judged(sentence: str) -> str:
    """The sentence, if it is one: short, on one line, with what, where and remedy."""
    if len(sentence) > LONGEST or not sentence.replace("\N{NO-BREAK SPACE}", "").isprintable() or ": " not in sentence:
        raise AssertionError(f"is not a sentence ({len(sentence)} characters): {sentence[:120]!r}")
    return sentence


def shares(total: int) -> dict[str, int]:
    """How many inputs of each kind make so many."""
    return {kind: max(1, math.ceil(total * part)) for kind, (_, part) in KINDS.items()}


def prepare() -> None:
    """Compute once what all inputs start from."""
    for start in (machine_texts, log_text, sheet_text, estimate, _plant):
        start()
