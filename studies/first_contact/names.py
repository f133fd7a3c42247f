"""Identifiers that code could treat specially, as names of links, cylinders, sensors and machines.

Words of hydroopt's own files, tables and channels, keywords of C, C++, Python and TOML, units, devices of Windows,
names that differ from another one by case, and what is no name: each as the name of the link that a cylinder moves, of
the cylinder, of an inertial measurement unit and of the machine. What hydroopt answers must be what it answers with a
neutral name, word for word but for the name, or one sentence. Every name goes through `show`, `simulate`, `check`,
`identify` on the same log, the page of the answer, the saved answer, `convert` to URDF, MJCF and SDF and back, and
`codegen`; a share of them through `excite` and the compiled self-test, too.
"""

from __future__ import annotations

import itertools
import json
import re
import shutil
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hydroopt.cli.machine_facts import machine_facts
from hydroopt.codegen.folder import Code
from hydroopt.codegen.parameter_source import Origin
from hydroopt.errors import LONGEST, HydrooptError
from hydroopt.estimation.dynamic.log_check import check_logs
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.excitation.motion.design import excitation_problem
from hydroopt.limits.reserves import Reserves
from hydroopt.logs.log_files import read_log
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, load_machine, read_machine
from hydroopt.machine.robot_formats.writing import robot_files
from hydroopt.model.model import Model
from hydroopt.report import identification
from hydroopt.results.answer import load
from hydroopt.simulation.simulate import random_trajectory, simulate
from hydroopt.solving import solve

FOLDER = Path(tempfile.mkdtemp(prefix="names-"))
"""Where logs and answers are written, the same for all names."""
_WORD = re.compile(r"[\w.%]+")
ROLES = ("link", "cylinder", "sensor", "machine")
NEUTRAL = {role: f"qv{role}" for role in ROLES}
"""Names that nothing treats specially, and that occur nowhere else."""
SHARE = 12
"""Of so many names one goes through what takes seconds: the design of a motion, and a compiler."""
WORDS = tuple(dict.fromkeys(f"""
ground base tip load world t pump chassis site tool calibrator q qd qdd tau f time gravity rod barrel all friction none
default nan inf true false null NaN None NULL infinity oil tracker footprint workspace obstacle payload wrench faults
sensors imus links loops joints machine parameter parameters name value sigma source notes note body com mass inertia
pose stage fixture row file setup sample segment length force u p_head p_rod p_a x y z roll pitch yaw gyro_x accel_x
offset coulomb viscous seal lag reading readings effort geometry supply state psi constants params prepare status index
base_roll base_x rocker coupler axis mount qvlink_mount
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef union unsigned void volatile while main abs sin cos
sqrt exp log pow fabs NAN INFINITY M_PI EOF errno assert stdin printf memcpy size_t bool uint8_t
alignas and asm catch class constexpr decltype delete explicit export friend mutable namespace new noexcept nullptr
operator or private protected public template this throw try typename using virtual xor not
as async await def del elif except finally from global import in is lambda nonlocal pass raise with yield self print
object list dict str type id eval exec __init__ numpy np pd ca casadi
con prn aux nul com1 lpt1 CON
m kg N Pa rad deg s mm bar e E i j k l n o O I pi a d theta alpha beta
constructor prototype toString length hasOwnProperty undefined arguments window document
select table order join html body script
MAST Mast Station turner_ long_name_{"x" * 40} {"y" * 300}
a-b a.b 1st _x é x/y ../x a:b a{chr(92)}b {chr(27)} &amp; <b> $x %s {{x}} #x x;y '
""".split()))
"""What is tried as a name; those that differ from a part's name by case only, and those that are no names, last."""
MACHINE = """name = {machine}
ground = "-1 m"
orientation = ["1 deg", "0 deg", "0 deg"]
bandwidth = "3 Hz"
[[links]]
name = "mast"
[links.joint]
type = "revolute"
lower = "-90 deg"
upper = "90 deg"
d = "0.5 m"
alpha = "90 deg"
max_speed = "40 deg/s"
max_acceleration = "60 deg/s^2"
[links.body]
m = {{ value = "80 kg", sigma = "20 %" }}
com = ["0 m", "-0.2 m", "0 m"]
inertia_com = ["4 kg*m^2", "0 kg*m^2", "0 kg*m^2", "3 kg*m^2", "0 kg*m^2", "4 kg*m^2"]
[[links]]
name = {link}
[links.joint]
type = "revolute"
lower = "0 deg"
upper = "60 deg"
a = {{ value = "2 m", sigma = "2 mm" }}
max_speed = "30 deg/s"
max_acceleration = "60 deg/s^2"
[links.body]
m = {{ value = "120 kg", sigma = "20 %", source = "guess" }}
com = ["1 m", "0 m", "0 m"]
inertia_com = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "40 kg*m^2", "0 kg*m^2", "40 kg*m^2"]
[[drives]]
name = "turner"
joint = "mast"
max_torque = "900 N*m"
friction = {{ coulomb = "20 N*m", viscous = "5 N*m*s/rad" }}
[[cylinders]]
name = {cylinder}
bore = "100 mm"
rod_diameter = "56 mm"
dead_length = {{ value = "0.8 m", sigma = "2 mm" }}
stroke = "1.2 m"
max_speed = "0.5 m/s"
relief_pressure = "200 bar"
barrel = {{ link = "mast", pin = ["0.2 m", "0 m", "-0.9 m"] }}
friction = {{ coulomb = "200 N", viscous = "900 N*s/m", offset = {{ value = "0 N", sigma = "50 N" }} }}
[cylinders.rod]
link = {link}
pin = ["0.8 m", "0 m", "0 m"]
[[sensors]]
channels = ["mast.q", {link_q}]
accuracy = "0.02 deg"
distribution = "gaussian"
rate = "100 Hz"
[[sensors]]
channels = [{cylinder_head}, {cylinder_rod}]
accuracy = "0.3 bar"
[[sensors]]
channels = ["mast.tau"]
accuracy = "5 N*m"
[[imus]]
name = {sensor}
link = {link}
position = ["0.5 m", "0.1 m", "0 m"]
rate = "100 Hz"
gyroscope = {{ noise = "0.01 deg/s/Hz^0.5", bias = "0.1 deg/s" }}
[[obstacles]]
name = "cab"
link = "mast"
centre = ["0 m", "0 m", "3 m"]
radius = "0.3 m"
[[targets]]
name = "prism"
link = {link}
position = ["1.9 m", "0 m", "0 m"]
[[targets]]
name = "mark"
position = ["4 m", "0 m", "0 m"]
[[instruments]]
name = "station"
"""




def machine_text(names: dict[str, str]) -> str:
    """The machine file with these names by role."""
    text = names | {"link_q": f"{names['link']}.q", "cylinder_head": f"{names['cylinder']}.p_head",
                    "cylinder_rod": f"{names['cylinder']}.p_rod"}
    return MACHINE.format(**{key: json.dumps(value, ensure_ascii=False) for key, value in text.items()})


def answers(names: dict[str, str], *, thorough: bool) -> Iterator[tuple[str, Any]]:
    """What hydroopt answers of the machine with these names, step by step: the step, and what of it must not change."""
    machine = read_machine(machine_text(names))
    yield "read", read_machine(dump_machine(machine)) == machine
    model = Model(machine)
    motion = random_trajectory(model, duration=4.0, rate=40.0, seed=1)
    yield "show", _plain(machine_facts(machine, motion))
    for ending in (".urdf", ".xml", ".sdf"):
        yield f"convert to {ending}", _converted(machine, ending)
    file, folder = FOLDER / "log.csv", FOLDER / "answer"
    shutil.rmtree(folder, ignore_errors=True)
    simulate(model, motion, seed=3).write(file)
    log = read_log(file)
    yield "simulate", {name: values.tolist() for name, values in log.channels.items()}
    yield "check", _plain(check_logs(machine, [log]).content())
    problem = identification_problem(machine, [log], [])
    estimate = solve(problem, "sdp")
    yield "identify", _plain(estimate.content())
    estimate.save(folder, pages={"report.html": identification.render(estimate)})
    stated = problem.subject_to("own", f"{names['link']}.m >= 10 kg").with_prior(
        "sum", f"{names['link']}.m + mast.m = 200 +- 9 kg")
    yield "constraint", list(stated.stated_constraints)
    saved = load(folder)
    yield "saved answer", [len(str(saved)) > 0, {name: row.value for name, row in saved.parameters.items()}]
    yield "calibrated machine", _plain(load_machine(folder).model_dump())
    files = Code(machine, Origin("nominal", "0" * 64)).files()
    yield "codegen", sum(text.count("\n") for text in files.values())
    if thorough:
        motion_problem = excitation_problem(machine, Fourier(period=6.0, harmonics=2), reserves=Reserves())
        yield "excite", solve(motion_problem, starts=1, search_seconds=1e9).trajectory.q.round(9).tolist()
        yield "self-test", _self_test(files)


def _converted(machine: Machine, ending: str) -> Any:
    """Texts of a machine in another format by name, and the machine that is read from them."""
    files = robot_files(machine, f"robot{ending}").files
    if ending == ".sdf":
        return sorted(files)
    with tempfile.TemporaryDirectory() as folder:
        for name, text in files.items():
            (Path(folder) / name).write_text(text, "utf-8")
        return [sorted(files), _plain(load_machine(Path(folder) / f"robot{ending}").model_dump())]


def _self_test(files: dict[str, str]) -> str:
    """What the compiled self-test prints."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in files.items():
            (Path(folder) / name).write_text(text, "utf-8")
        done = subprocess.run(["make", "CFLAGS=-O0", "check"], cwd=folder, text=True, capture_output=True, check=False)
        return done.stdout.rpartition("\n./")[2].partition("\n")[2] if not done.returncode else done.stderr


def _plain(content: Any) -> Any:
    """The content without what depends on time and on the whole text of the machine's description."""
    if isinstance(content, dict):
        return {key: _plain(value) for key, value in content.items()
                if key not in ("sha256", "created", "wall_s", "versions", "inputs")}
    if isinstance(content, list | tuple):
        return [_plain(value) for value in content]
    return float(f"{content:.9g}") if isinstance(content, float) else content


def renamed(content: Any, names: dict[str, str]) -> Any:
    """The content of the neutral names with others in their places."""
    if isinstance(content, dict):
        return {renamed(key, names): renamed(value, names) for key, value in content.items()}
    if isinstance(content, list):
        return [renamed(value, names) for value in content]
    if isinstance(content, str):
        for role, name in NEUTRAL.items():
            content = content.replace(name, names[role])
    return content


def difference(one: Any, other: Any) -> str:
    """Where two contents differ first; "" where they do not."""
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        return next((f".{key}{at}" for key in one if (at := difference(one[key], other[key]))), "")
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        if all(isinstance(each, str) for each in (*one, *other)):
            one, other = sorted(one), sorted(other)
        pairs = enumerate(zip(one, other, strict=True))
        return next((f"[{k}]{at}" for k, pair in pairs if (at := difference(*pair))), "")
    if isinstance(one, str) and isinstance(other, str):  # lists of names in a sentence are sorted
        return "" if sorted(_WORD.findall(one)) == sorted(_WORD.findall(other)) else f": {other[:300]!r}"
    return "" if one == other else f": {str(one)[:200]} is {str(other)[:200]}"


def tried(role: str, word: str, expected: dict[str, Any], *, thorough: bool) -> str:
    """How a name ended: "same", "refused: SENTENCE", or "differs: STEP"; what is none of these is raised.

    Args:
        role: one of `ROLES`.
        word: the name.
        expected: what `answers` are with the neutral names; steps behind the last one of them are left out.
        thorough: see `answers`.
    """
    names = NEUTRAL | {role: word}
    try:
        for (step, answer), _ in zip(answers(names, thorough=thorough), expected, strict=False):
            if where := difference(renamed(expected[step], names), answer):
                return f"differs: {step}{where}"
    except HydrooptError as error:
        sentence = str(error)
        if len(sentence) > LONGEST or not sentence.isprintable() or "; " not in sentence:
            raise AssertionError(f"is not a sentence: {sentence[:200]!r}") from None
        return f"refused: {sentence}"
    return "same"


def run(first: int = 0, step: int = 1, *, compilers: bool = True) -> dict[str, float]:
    """Try the names from the first one on, every so many of them; what differs and tracebacks are printed."""
    compilers = compilers and shutil.which("make") is not None
    expected = dict(answers(NEUTRAL, thorough=compilers))
    found: Counter[str] = Counter()
    for k, (word, role) in enumerate(list(itertools.product(WORDS, ROLES))[first::step]):
        try:
            ended = tried(role, word, expected, thorough=compilers and k % SHARE == 0)
        except Exception:
            ended = "traceback"
            print(f"{role} {word!r}: {traceback.format_exc(limit=-3)}", file=sys.stderr)
        found[ended.partition(":")[0]] += 1
        if ended != "same":
            print(f"{role} {word!r} {ended}", file=sys.stderr)
    return {"names_tried": float(len(WORDS[first::step]) if step == 1 else sum(found.values())),
            "names_roles": float(sum(found.values())), "names_same": float(found["same"]),
            "names_refused": float(found["refused"]), "names_differ": float(found["differs"]),
            "names_tracebacks": float(found["traceback"])}


if __name__ == "__main__":
    print(run(*map(int, sys.argv[1:])))
