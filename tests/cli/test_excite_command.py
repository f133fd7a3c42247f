"""The command as a user runs it: what it writes agrees with itself, with the machine, and with the C that it writes."""

from __future__ import annotations

import ctypes
import hashlib
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from excitation.motion.test_basis import Fourier, Spline, series, spline
from typer.testing import CliRunner

from fixtures.pages import stands_alone, text_of
from fixtures.tiers import tiered
from hydroopt import Model, load_machine, read_log
from hydroopt.cli import app
from hydroopt.cli.excite import _basis
from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.identifiability import structural
from hydroopt.excitation.criteria import CRITERIA, presumed_noise
from hydroopt.spatial.inertia import NAMES

Array = np.ndarray
QUICK = ("--duration", "8", "--starts", "4", "--processes", "1")
SERIES = ("patu655_lift", *QUICK, "--blend", "1", "--harmonics", "3")
SPLINE = ("patu655_lift", *QUICK, "--pieces", "7")
RESTING = ("cat215b", *QUICK, "--blend", "1", "--harmonics", "2", "--rest", "swing = 10 deg")
KINDS = {"series": SERIES, "spline": SPLINE, "resting": RESTING}
RESTS = {"series": (), "spline": (), "resting": ("swing",)}
FILES = {"excitation.json", "report.html", "sheet.html", "trajectory.csv", "c"}


def excite(*arguments: str | Path) -> str:
    done = CliRunner().invoke(app, ["excite", *map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def content(directory: Path) -> dict:
    return json.loads((directory / "excitation.json").read_text("utf-8"))


def table(directory: Path) -> tuple[list[str], Array]:
    """Header and numbers of the trajectory."""
    lines = (directory / "trajectory.csv").read_text("utf-8").splitlines()
    return lines[0].split(","), np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])


def states(directory: Path) -> tuple[Array, Array, Array, Array]:
    """Times (N,), positions, speeds and accelerations (N, n) of the trajectory."""
    _, rows = table(directory)
    return rows[:, 0], rows[:, 1::3], rows[:, 2::3], rows[:, 3::3]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """The directory that a command wrote, once for all tests."""
    home = tmp_path_factory.mktemp("excite")

    @cache
    def get(*arguments: str) -> Path:
        directory = home / str(len(list(home.iterdir())))
        assert excite(*arguments, "-o", directory, "--quiet") == ""
        return directory

    return get


# files

@pytest.mark.parametrize("kind", tiered(KINDS, lambda kind: kind == "series"))
def test_files_are_there_and_say_what_was_asked(kind: str, written: Callable[..., Path]) -> None:
    directory = written(*KINDS[kind])
    said, (machine, *_) = content(directory), KINDS[kind]
    assert {file.name for file in directory.iterdir()} == FILES
    assert said["machine"]["name"] == machine
    assert said["machine"]["sha256"] == load_machine(machine).sha256
    assert (said["duration"], said["starts"], said["seed"], said["stopped"]) == (8, 4, 0, "")
    assert said["basis"] == ({"kind": "spline", "time": 8, "pieces": 7} if kind == "spline" else {
        "kind": "fourier", "period": 6, "harmonics": 3 if kind == "series" else 2, "repeats": 1, "blend": 1})
    t, *_ = states(directory)
    assert len(t) == said["samples"] == 8 * said["rate"] + 1
    np.testing.assert_allclose(t, np.arange(len(t)) / said["rate"], rtol=1e-12)


@pytest.mark.parametrize("kind", tiered(KINDS, lambda kind: kind == "series"))
def test_coefficients_make_the_trajectory(kind: str, written: Callable[..., Path]) -> None:
    """By functions that are built of other parts than those of the program."""
    directory = written(*KINDS[kind])
    said, (t, *motion) = content(directory), states(directory)
    made = {key: value for key, value in said["basis"].items() if key != "kind"}
    coefficients = np.array(list(said["coefficients"].values())).T
    assert coefficients.shape == (len(said["functions"]), motion[0].shape[1])
    for order, found in enumerate(motion):
        rows = spline(Spline(**made), t, order) if kind == "spline" else series(Fourier(**made), t, order)
        np.testing.assert_allclose(found, rows @ coefficients, rtol=0, atol=1e-10 * np.max(np.abs(found)))


@pytest.mark.parametrize("kind", tiered(KINDS, lambda kind: kind == "series"))
def test_trajectory_is_a_log(kind: str, written: Callable[..., Path]) -> None:
    directory = written(*KINDS[kind])
    log, (header, rows), machine = (read_log(directory / "trajectory.csv"), table(directory),
                                    load_machine(KINDS[kind][0]))
    np.testing.assert_array_equal(log.t, rows[:, 0])
    for joint in machine.joints:
        assert log.units[f"{joint}.q"] == "rad"
        np.testing.assert_array_equal(log.channel(f"{joint}.q"), rows[:, header.index(f"{joint}.q [rad]")])


@pytest.mark.parametrize("kind", tiered(KINDS, lambda kind: kind == "series"))
def test_trajectory_begins_and_ends_at_rest(kind: str, written: Callable[..., Path]) -> None:
    _, q, qd, qdd = states(written(*KINDS[kind]))
    assert np.max(np.ptp(q, axis=0)) > 0.1, "it moves"
    for part in (qd, qdd):
        assert np.max(np.abs(part[[0, -1]])) < 1e-12 * np.max(np.abs(part))


@pytest.mark.parametrize("kind", tiered(KINDS, lambda kind: kind == "series"))
def test_limits_are_kept_with_room(kind: str, written: Callable[..., Path]) -> None:
    """What the trajectory itself, reckoned with the machine's geometry here, uses of some."""
    directory = written(*KINDS[kind])
    machine = load_machine(KINDS[kind][0])
    limits = {limit["name"]: limit for limit in content(directory)["limits"]}
    assert len(limits) == len(content(directory)["limits"])
    for limit in limits.values():
        below = limit["lowest"] - (limit["lower"] if limit["lower"] is not None else -np.inf)
        above = (limit["upper"] if limit["upper"] is not None else np.inf) - limit["highest"]
        assert limit["room"] >= 0, limit
        assert limit["room"] == min(below, above)
    _, q, qd, qdd = states(directory)
    for k, joint in enumerate(machine.joints):
        own = machine.link(joint).joint
        for what, values, bounds in (("position", q, own.range), ("speed", qd, (own.max_speed,)),
                                     ("acceleration", qdd, (own.max_acceleration,))):
            if bounds[-1] is not None:
                found = limits[f"{joint} {what}"]
                margin = 3 * 0.005 * np.ptp(own.range) if what == "position" and joint not in RESTS[kind] else 0.0
                low, high = bounds if what == "position" else (-bounds[0], bounds[0])
                assert (found["lower"], found["upper"]) == pytest.approx((low + margin, high - margin))
                np.testing.assert_allclose([found["lowest"], found["highest"]],
                                           [values[:, k].min(), values[:, k].max()], rtol=0, atol=1e-12)
    if kind == "resting":
        return
    cylinder = machine.cylinders[0]  # from the base's pin to that of the arm, which turns by theta and q
    (bx, by, _), (rx, ry, _) = cylinder.barrel.pin, cylinder.rod.pin
    angle = q[:, 0] + machine.links[0].joint.theta
    length = np.hypot(rx * np.cos(angle) - ry * np.sin(angle) - bx, rx * np.sin(angle) + ry * np.cos(angle) - by)
    stroke = limits["lift_cylinder stroke"]
    np.testing.assert_allclose([stroke["lowest"], stroke["highest"]], [length.min(), length.max()], rtol=1e-9)
    assert {"lift_cylinder p_head", "lift_cylinder p_rod"} < limits.keys()


@pytest.mark.slow
def test_joint_that_rests_does_so_exactly(written: Callable[..., Path]) -> None:
    directory = written(*RESTING)
    said, (_, q, qd, qdd) = content(directory), states(directory)
    assert said["resting"] == {"swing": np.radians(10)}
    assert np.all(q[:, 0] == np.radians(10))
    assert np.all(qd[:, 0] == 0)
    assert np.all(qdd[:, 0] == 0)
    assert np.all(np.ptp(q[:, 1:], axis=0) > 0.1)
    swing = next(row for row in said["parameters"] if row["name"] == "swing_motor.tau_coulomb")
    assert swing["std"] == pytest.approx(swing["prior_std"], rel=1e-6)
    assert "swing at 10 deg" in (directory / "report.html").read_text("utf-8")


@pytest.mark.parametrize("kind", tiered(KINDS, lambda kind: kind == "series"))
def test_deviations_before_are_the_file_s(kind: str, written: Callable[..., Path]) -> None:
    model = Model(load_machine(KINDS[kind][0]))
    scale = model.parameters.scale
    covariance = np.linalg.inv(model.parameters.information * np.outer(scale, scale))
    before, after = (np.array([row[std] for row in content(written(*KINDS[kind]))["parameters"]])
                     for std in ("prior_std", "std"))
    np.testing.assert_allclose(before, scale * np.sqrt(np.diag(covariance)), rtol=1e-6)
    assert np.all(after <= before * (1 + 1e-9))
    assert np.any(after < 0.6 * before)


@pytest.mark.slow
def test_parquet_holds_the_same_and_takes_the_place_of_the_other(written: Callable[..., Path], tmp_path: Path) -> None:
    first = written(*SERIES)
    shutil.copytree(first, tmp_path / "out")
    excite(*SERIES, "-o", tmp_path / "out", "--parquet", "--quiet")
    assert {file.name for file in (tmp_path / "out").iterdir()} == FILES - {"trajectory.csv"} | {"trajectory.parquet"}
    one, other = read_log(first / "trajectory.csv"), read_log(tmp_path / "out/trajectory.parquet")
    np.testing.assert_array_equal(one.t, other.t)
    assert one.channels.keys() == other.channels.keys()
    for name in one.channels:
        np.testing.assert_array_equal(one.channel(name), other.channel(name))


@pytest.mark.slow
def test_json_is_the_file_and_summary_names_the_report(tmp_path: Path) -> None:
    printed = json.loads(excite(*SERIES, "-o", tmp_path / "json", "--json"))
    assert printed == content(tmp_path / "json")
    text = excite(*SERIES, "-o", tmp_path / "text")
    assert str(tmp_path / "text/report.html") in text.replace("\n", "")
    for each in printed["diagnostics"]:
        assert f"! {each['text']}" in text


@pytest.mark.slow
def test_nothing_is_written_where_foreign_c_lies(tmp_path: Path) -> None:
    (tmp_path / "c").mkdir()
    (tmp_path / "c/patu655_lift.c").write_text("int main(void) { return 0; }\n")
    done = CliRunner().invoke(app, ["excite", *SERIES, "-o", str(tmp_path), "--quiet"])
    assert isinstance(done.exception, ProblemError)
    assert "was not generated by hydroopt" in str(done.exception)
    assert [file.name for file in tmp_path.rglob("*") if file.is_file()] == ["patu655_lift.c"]


@pytest.mark.slow
@pytest.mark.parametrize("flow", ["1e-3 L/hour", "0.01 L/min"])
def test_machine_that_can_hardly_move_is_told_why(flow: str, tmp_path: Path) -> None:
    """By a pump that is next to none; there may be a motion nevertheless."""
    text = (Path(__file__).parents[2] / "models/cat215b.toml").read_text("utf-8")
    assert text.count('"300 L/min"') == 1
    (tmp_path / "weak.toml").write_text(text.replace('"300 L/min"', f'"{flow}"'), "utf-8")
    done = CliRunner().invoke(app, ["excite", str(tmp_path / "weak.toml"), *RESTING[1:], "-o", str(tmp_path / "out")])
    if done.exit_code == 0:
        assert all(limit["room"] >= 0 for limit in content(tmp_path / "out")["limits"])
    else:
        assert isinstance(done.exception, ProblemError), done.exception
        assert "pump flow" in done.exception.what
        assert not (tmp_path / "out").exists()


# report

@pytest.mark.parametrize("kind", tiered(KINDS, lambda kind: kind == "series"))
def test_report_needs_nothing_from_outside_and_shows_everything(kind: str, written: Callable[..., Path]) -> None:
    page = (written(*KINDS[kind]) / "report.html").read_text("utf-8")
    said = content(written(*KINDS[kind]))
    assert stands_alone(page)
    shown = page.replace("\u00a0", " ")
    for limit in said["limits"]:
        assert limit["name"] in shown, limit["name"]
    for each in said["diagnostics"]:
        assert each["text"] in shown
    for name in (row["name"] for row in said["parameters"]):
        assert name.rpartition(".")[0] in shown
        assert re.search(rf"[>\s]{name.rpartition('.')[2]}[<\s]", shown)
    assert not re.search(r"\b(nan|inf|None)\b", re.sub(r"<svg.*?</svg>", "", text_of(page), flags=re.DOTALL))


# C

def _must(directory: Path, *command: str) -> str:
    done = subprocess.run(command, cwd=directory, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


SHIM = """
#include "{0}.h"
#include "{0}_params.h"
int moved(double t, {0}_motion_t *out)
{{
    {0}_constants_t constants;
    const {0}_instant_t in = {{{{t}}}};
    const {0}_status_t status = {0}_prepare(&{0}_values, &constants);
    return status == 0 ? (int){0}_excitation(&constants, &in, out) : (int)status;
}}
"""


@pytest.mark.parametrize("kind", tiered(KINDS, lambda kind: kind == "series"))
def test_c_tests_itself(kind: str, written: Callable[..., Path], tmp_path: Path) -> None:
    shutil.copytree(written(*KINDS[kind]) / "c", tmp_path / "c")
    assert "self-test passed" in _must(tmp_path / "c", "make", "check", "CFLAGS=-O0 -Werror")


@pytest.mark.parametrize("kind", tiered(KINDS, lambda kind: kind == "series"))
def test_c_moves_as_the_trajectory_says(kind: str, written: Callable[..., Path], tmp_path: Path) -> None:
    name, place = KINDS[kind][0], shutil.copytree(written(*KINDS[kind]) / "c", tmp_path / "c")
    (place / "shim.c").write_text(SHIM.format(name))
    sources = [file.name for file in place.glob("*.c") if not file.name.endswith("_selftest.c")]
    _must(place, "cc", "-std=c99", "-O2", "-shared", "-fPIC", "-o", "moved.so", *sources, "-lm")
    moved = ctypes.CDLL(str(place / "moved.so")).moved
    t, *motion = states(written(*KINDS[kind]))
    joints = motion[0].shape[1]
    buffer = (ctypes.c_double * (3 * joints))()

    def at(time: float) -> Array:
        """Positions, speeds and accelerations (3, n)."""
        assert moved(ctypes.c_double(time), buffer) == 0
        return np.array(buffer).reshape(3, joints)

    said, found = np.stack(motion, axis=1), np.array([at(time) for time in t])
    for k in range(3):
        assert np.max(np.abs(found[:, k] - said[:, k])) < 1e-12 * max(1.0, np.max(np.abs(said[:, k])))
    for time, end in ((-1.0, 0), (-1e3, 0), (t[-1] + 1e-6, -1), (t[-1] + 1e3, -1)):
        np.testing.assert_allclose(at(time), said[end], rtol=0, atol=1e-12 * np.max(np.abs(said)))
    if kind == "resting":
        assert np.all(found[:, 0, 0] == said[0, 0, 0])
        assert np.all(found[:, 1:, 0] == 0)
    assert moved(ctypes.c_double(np.nan), buffer) == 4  # NOT_FINITE


# options

def covariance(directory: Path) -> tuple[Array, list[str]]:
    """Of the scaled base parameters, by sums over all samples, and their names."""
    model = Model(load_machine(content(directory)["machine"]["name"]))
    _, q, qd, qdd = states(directory)
    columns = list(structural(model).basis)
    K = np.array([np.asarray(model.regressor(*each)) for each in zip(q, qd, qdd, strict=True)])[:, :, columns]
    rows = (K / presumed_noise(model)[:, None] * model.parameters.scale[columns]).reshape(-1, len(columns))
    return np.linalg.inv(rows.T @ rows), [model.parameters.names[k] for k in columns]


def judged(criterion: str, spread: Array) -> float:
    """Logarithm of what a criterion says of a covariance."""
    values = np.linalg.eigvalsh(spread)
    return float({"D": np.mean(np.log(values)), "A": np.log(np.mean(values)), "E": np.log(values[-1]),
                  "condition": np.log(values[-1] / values[0]) / 2}[criterion])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_each_criterion_is_best_served_by_the_motion_for_it(seed: int, written: Callable[..., Path]) -> None:
    """With as many starts as there are without an option: four may all miss the best of this lift's many optima."""
    asked = (*SERIES, "--starts", "16", "--seed", seed, "--criterion")
    made = {each: covariance(written(*asked, each))[0] for each in CRITERIA}
    for criterion in CRITERIA:
        said = content(written(*asked, criterion))
        assert said["criterion"] == criterion
        own = judged(criterion, made[criterion])
        assert all(own <= judged(criterion, other) + 0.05 for other in made.values()), criterion
        assert said["value"] == pytest.approx(own, abs=1e-4)
    assert judged("D", made["D"]) < judged("D", made["condition"])
    assert content(written(*asked, "condition"))["condition_numbers"]["scaled"] == pytest.approx(
        np.sqrt(np.linalg.cond(made["condition"])), rel=0.02)


@pytest.mark.slow
def test_focus_serves_what_it_is_on(written: Callable[..., Path]) -> None:
    found = {name: covariance(written(*SERIES, *(("--focus", name) if name else ())))
             for name in ("friction", "lift.mc_x", "")}
    assert content(written(*SERIES, "--focus", "friction"))["focus"] == ["friction"]
    names = found[""][1]
    places = {"friction": [k for k, name in enumerate(names) if name.rpartition(".")[2] not in NAMES],
              "lift.mc_x": [names.index("lift.mc_x")], "": list(range(len(names)))}
    assert [names[k] for k in places["friction"]] == ["lift_cylinder.f_coulomb", "lift_cylinder.f_viscous"]

    def served(focus: str, motion: str) -> float:
        return judged("D", found[motion][0][np.ix_(places[focus], places[focus])])

    assert served("friction", "friction") < served("friction", "lift.mc_x") - 0.5
    assert served("lift.mc_x", "lift.mc_x") < served("lift.mc_x", "friction") - 0.5
    assert served("lift.mc_x", "lift.mc_x") < served("lift.mc_x", "") - 0.5
    assert served("", "") < served("", "lift.mc_x") - 0.5


@pytest.mark.slow
def test_priors_are_asked_for(written: Callable[..., Path]) -> None:
    whole = *SERIES, "--starts", "16"  # a few end in other optima, and differ by more
    said = content(written(*whole, "--priors"))
    assert said["priors"]
    assert said["value"] == pytest.approx(content(written(*whole))["value"], abs=0.1)  # they tell little here


@pytest.mark.slow
def test_log_already_measured_is_taken_into_account(written: Callable[..., Path], tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["simulate", "patu655_lift", "-o", str(tmp_path), "--duration", "20", "--quiet"])
    assert done.exit_code == 0
    log = tmp_path / "log.csv"
    excite(*SERIES, "--log", log, "-o", tmp_path / "out", "--quiet")
    with_log, without = content(tmp_path / "out"), content(written(*SERIES))
    (measured,) = with_log["inputs"]
    assert (measured["path"], measured["sha256"]) == (str(log), hashlib.sha256(log.read_bytes()).hexdigest())
    before, alone = (np.array([row["prior_std"] for row in said["parameters"]]) for said in (with_log, without))
    assert np.all(before <= alone * (1 + 1e-9))
    assert np.any(before < 0.5 * alone)
    after = np.array([row["std"] for row in with_log["parameters"]])
    assert np.all(after <= before * (1 + 1e-9))
    assert with_log["value"] < without["value"]


@pytest.mark.slow
def test_processes_side_by_side_find_the_same(tmp_path: Path) -> None:
    found = []
    for processes in ("1", "2"):
        excite("patu655_lift", "--duration", "8", "--blend", "1", "--harmonics", "2", "--starts", "2",
               "--processes", processes, "-o", tmp_path / processes, "--quiet")
        found.append(content(tmp_path / processes))
    assert found[0]["value"] == pytest.approx(found[1]["value"], abs=1e-9)
    for joint, coefficients in found[0]["coefficients"].items():
        np.testing.assert_allclose(coefficients, found[1]["coefficients"][joint], rtol=0, atol=1e-6)


@pytest.mark.parametrize(("bandwidth", "harmonics", "blend"), [(None, 10, 2.0), (5.0, 10, 2.0), (0.5, 5, 5.0)])
def test_motions_stay_well_below_the_bandwidth(bandwidth: float | None, harmonics: int, blend: float) -> None:
    """Smoothing takes away what is near the bandwidth."""
    basis = _basis(33.0, None, None, None, None, bandwidth)
    assert (basis.harmonics, basis.blend) == (harmonics, blend)
