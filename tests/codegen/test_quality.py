"""What tools say of the generated C: compilers, sanitizers, a static analyser, and the folder's own self-test."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import sys
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fixtures import library
from fixtures.fuzz import INPUTS, MODES, driver
from fixtures.library import OK, OUT_OF_STROKE, run, sources, write
from fixtures.tiers import tiered
from fixtures.tools import Tool, must
from hydroopt.codegen.folder import STATUSES, Code
from hydroopt.codegen.parameter_source import read
from hydroopt.codegen.routines import ROUTINES
from hydroopt.codegen.sizes import CORTEX_M4F
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import bundled

STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Wmissing-prototypes",
          "-Wdouble-promotion", "-Werror")
REALS = ("double", "float")
OPTIMISED = {"cat215b": "-O2", "patu655_lift": "-O2", "kr300": "-O2", "panda_mukca": "-O1"}
"""How machines are compiled where it takes the optimiser's time."""
MACHINES = tuple(OPTIMISED)
SINGLE = {f"{name}f" for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sqrt", "fabs", "pow", "exp",
                                  "log", "sincos", "tanh", "fmin", "fmax")} | {"memcpy", "memset"}
"""What single precision may call: the last two are for a compiler to call where a struct is copied."""
SANITIZE = ("-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")
FUZZED = (("cat215b", "double"), ("patu655_lift", "float"), ("kr300", "float"))
QUICK = {("patu655_lift", "float"), ("patu655_lift", "double")}
"""Machines and precisions whose code is generated and compiled in a second; the others are slow."""


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """The generated folder of a machine; nothing is built in it."""
    home = tmp_path_factory.mktemp("generated")
    return cache(lambda subject, real: write(library.files(library.subject(subject, real)), home / f"{subject}_{real}"))


@pytest.fixture(scope="session")
def objects(folder, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., list[Path]]:
    """The objects that a compiler makes of a machine's sources, without a warning."""
    home = tmp_path_factory.mktemp("objects")

    @cache
    def get(subject: str, real: str, compiler: str, *flags: str) -> list[Path]:
        place = home / "_".join((subject, real, compiler, *flags[:1]))
        place.mkdir()
        source = folder(subject, real)
        names = sources(source)
        must([compiler, *STRICT, *flags, "-c", *(source / name for name in names)], place)
        return [place / name.replace(".c", ".o") for name in names]

    return get


def copied(source: Path, target: Path) -> Path:
    shutil.copytree(source, target)
    return target


# warnings

@pytest.mark.parametrize("compiler", ["cc", Tool("clang")])
@pytest.mark.parametrize(("machine", "real"), tiered([
    *((machine, "float") for machine in bundled()), *((machine, "double") for machine in MACHINES),
    ("cat215b folded", "float"), ("spatial", "double")], lambda *case: case in QUICK))
def test_compilers_do_not_warn(machine: str, real: str, compiler: str, folder) -> None:
    place = folder(machine, real)
    must([compiler, *STRICT, "-fsyntax-only", *sorted(file.name for file in place.glob("*.c"))], place)


@pytest.mark.parametrize("compiler", [Tool("g++"), Tool("clang++")])
def test_header_serves_cpp(compiler: str, folder) -> None:
    place = folder("cat215b", "double")
    must([compiler, "-std=c++11", "-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only", "-x", "c++",
          "cat215b_params.h", "-Wno-unused-const-variable", "-Wno-unused-variable"], place)


@pytest.mark.parametrize(("machine", "routine"), tiered([
    *(("patu655_lift", name) for name in ROUTINES if name != "residual_by_geometry"),  # none of its numbers has a sigma
    ("cat215b", "residual_by_geometry"), ("cat215b", "cylinder_state"), ("cat215b", "tilted_regressor"),
    ("cat215b folded", "forward_kinematics"), ("panda_mukca", "actuator_forces")],
    lambda machine, routine: (machine, routine) in {("patu655_lift", "joint_state"), ("patu655_lift", "closure")}))
@pytest.mark.parametrize("compiler", ["cc", Tool("clang")])
def test_each_routine_can_be_had_alone(compiler: str, machine: str, routine: str, tmp_path: Path) -> None:
    place = write(library.files(library.subject(machine, "float", routine)), tmp_path / "alone")
    must([compiler, *STRICT, "-fsyntax-only", *sorted(file.name for file in place.glob("*.c"))], place)
    assert "self-test passed" in must(["make", "check", f"CC={compiler}", "CFLAGS=-O0"], place)


DRIVE = {"name": "solo", "drives": [{"name": "drive", "joint": "arm"}],
         "links": [{"name": "arm", "parent": "base", "joint": {"type": "revolute", "a": 1.0, "lower": -1, "upper": 1}}]}
WITH_BODY = DRIVE | {"links": [DRIVE["links"][0] | {"body": library.subjects.BODY}]}
UNUSUAL = {
    "nothing to identify": DRIVE,
    "friction only": DRIVE | {"drives": [{"name": "drive", "joint": "arm", "gear": 10, "rotor_inertia": 0.1,
                                          "friction": {"offset": 0, "coulomb": 0, "viscous": 0}}]},
    "a body only, without weight": WITH_BODY | {"gravity": 0.0},
    "a slide": DRIVE | {"links": [{"name": "arm", "parent": "base", "body": library.subjects.BODY,
                                   "joint": {"type": "prismatic", "lower": 0, "upper": 1}}]},
    "a tracked tip": WITH_BODY | {"calibrator": {"parent": "arm", "tip": (0.1, 0, 0)}, "tracker": {},
                                  "notes": {"calibrator.tip": {"sigma": 0.1}, "tracker.position": {"sigma": 0.1}}},
    "made up": library.subjects.MADE_UP}


@pytest.mark.parametrize("kind", UNUSUAL)
@pytest.mark.slow
def test_unusual_machines_build_and_test_themselves(kind: str, tmp_path: Path) -> None:
    routines = ("inverse_dynamics", "closure") if kind == "made up" else ()
    made = library.code(Machine.model_validate(UNUSUAL[kind]), single=True, routines=routines)
    place = write(library.files(made), tmp_path / "unusual")
    assert "self-test passed" in must(["make", "check", f"CFLAGS=-O0 {' '.join(STRICT)}"], place)


# single precision means single

DOUBLE_X86 = re.compile(r"^v?(cvt\w*[sp]d\w*|(add|sub|mul|div|sqrt|min|max|u?comi|cmp\w*|round|hadd|f\w+)[sp]d|f\w+)$")
DOUBLE_ARM = re.compile(r"\.f64\b|\bd\d+\b.*\bvcvt")


def instructions(listed: str) -> list[str]:
    """Mnemonics of a disassembly by ``objdump -d --no-show-raw-insn``."""
    return re.findall(r"^\s*[0-9a-f]+:\s+(?:rep \w+ |bnd |notrack )?([a-z][\w.]*)", listed, re.MULTILINE)


def undefined(listed: str, prefix: str) -> set[str]:
    """Symbols that objects want from elsewhere than from themselves."""
    return {name for name in re.findall(r"^\s+U (\S+)", listed, re.MULTILINE)
            if not name.startswith((f"{prefix}_", "_GLOBAL_OFFSET_TABLE_"))}


@pytest.mark.slow
def test_doubles_are_noticed_where_there_are_some(objects) -> None:
    listed = must(["objdump", "-d", "--no-show-raw-insn",
                   *objects("patu655_lift", "double", "cc", "-O2")], Path("."))
    found = set(filter(DOUBLE_X86.match, instructions(listed)))
    assert {"mulsd", "addsd"} <= found


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="this is no x86-64")
@pytest.mark.parametrize("machine", tiered(MACHINES, lambda machine: (machine, "float") in QUICK))
@pytest.mark.slow
def test_single_precision_has_no_double_instruction(machine: str, objects) -> None:
    made = objects(machine, "float", "cc", OPTIMISED[machine])
    found = instructions(must(["objdump", "-d", "--no-show-raw-insn", *made], Path(".")))
    assert "mulss" in found
    assert not Counter(filter(DOUBLE_X86.match, found))
    assert undefined(must(["nm", *made], Path(".")), machine) <= SINGLE


@pytest.mark.needs("arm-none-eabi-gcc")
@pytest.mark.parametrize("machine", tiered(MACHINES, lambda machine: (machine, "float") in QUICK))
def test_single_precision_has_no_double_instruction_on_a_controller(machine: str, objects) -> None:
    made = objects(machine, "float", "arm-none-eabi-gcc", "-O1", *CORTEX_M4F)
    listed = must(["arm-none-eabi-objdump", "-d", "--no-show-raw-insn", *made], Path("."))
    assert "vmul.f32" in listed
    assert not DOUBLE_ARM.search(listed)
    assert undefined(must(["arm-none-eabi-nm", *made], Path(".")), machine) <= SINGLE


def code_without_comments(text: str) -> str:
    return re.sub(r'/\*.*?\*/|"[^"\n]*"', " ", text, flags=re.DOTALL)


def floating(text: str) -> list[str]:
    """Floating-point literals of a C text."""
    found = re.findall(r"(?<![\w.])(?:\d+\.\d*|\.\d+|\d+(?=[eE]))(?:[eE][+-]?\d+)?\w*", code_without_comments(text))
    return [each for each in found if not each.startswith("0x")]


@pytest.mark.parametrize("machine", tiered(MACHINES, lambda machine: (machine, "float") in QUICK))
def test_literals_of_single_precision_say_so(machine: str, folder) -> None:
    place = folder(machine, "float")
    count = 0
    for file in (*place.glob("*.c"), *place.glob("*.h")):
        text = file.read_text("utf-8")
        assert not re.search(r"\bdouble\b", code_without_comments(text))
        for literal in floating(text):
            assert literal.endswith("f"), (file.name, literal)
            digits = re.sub(r"[eE].*|[f.]", "", literal).strip("0")
            assert len(digits) <= 9, (file.name, literal)
            assert np.isfinite(np.float32(literal[:-1]))
            count += 1
    assert count > 100


@pytest.mark.parametrize("machine", tiered(["cat215b", "panda_mukca"], lambda machine: machine == "cat215b"))
def test_literals_of_double_precision_are_exact(machine: str, folder) -> None:
    values = library.subject(machine, "double").interface.values
    found = set(map(float, floating((folder(machine, "double") / f"{machine}_params.h").read_text("utf-8"))))
    assert {abs(value) for array in values.values() for value in array.tolist()} <= found | {0.0}


# what a controller must not meet

@pytest.mark.parametrize(("machine", "real"), tiered([
    *((machine, "float") for machine in MACHINES), ("patu655_lift", "double")], lambda *case: case in QUICK))
@pytest.mark.slow
def test_no_state_is_kept_and_nothing_is_allocated_or_printed(machine: str, real: str, objects, folder) -> None:
    listed = must(["nm", *objects(machine, real, "cc", OPTIMISED[machine])], Path("."))
    assert not re.findall(r"^[0-9a-f]+ [BbDdCcGgSs] \S+", listed, re.MULTILINE)
    assert not undefined(listed, machine) & {"malloc", "calloc", "realloc", "free", "printf", "puts", "fprintf"}
    place = folder(machine, real)
    text = "".join(code_without_comments((place / name).read_text("utf-8")) for name in
                   (*sources(place), f"{machine}_internal.h"))
    assert set(re.findall(r"#include <(\S+)>", text)) == {"float.h", "math.h", "stddef.h"}
    assert not re.search(r"\bgoto\b|\bwhile\b|\bsetjmp\b", text)


@pytest.mark.parametrize("machine", tiered(MACHINES, lambda machine: machine in ("patu655_lift", "cat215b")))
def test_no_function_calls_itself_by_whatever_way(machine: str, folder) -> None:
    place = folder(machine, "double")
    text = "".join(code_without_comments((place / name).read_text("utf-8"))
                   for name in (f"{machine}_internal.h", *sources(place)))
    parts = re.split(r"^[\w ]*?\b(\w+)\([^;{]*\)\s*\n\{", text, flags=re.MULTILINE)
    bodies = dict(zip(parts[1::2], parts[2::2], strict=True))
    assert {f"{machine}_prepare", f"{machine}_regressor", f"{machine}_within"} <= bodies.keys()
    calls = {name: set(re.findall(r"\b(\w+)\(", body)) & bodies.keys() for name, body in bodies.items()}
    while free := [name for name, others in calls.items() if not others & calls.keys()]:
        for name in free:
            del calls[name]
    assert not calls


# static analysis

@pytest.mark.needs("cppcheck")
@pytest.mark.parametrize(("machine", "real"), [("patu655_lift", "double"), ("patu655_lift", "float")])
def test_cppcheck_finds_nothing(machine: str, real: str, folder) -> None:
    place = folder(machine, real)
    text = "".join(file.read_text("utf-8") for file in place.iterdir())
    assert "cppcheck-suppress" not in text
    must(["cppcheck", "--std=c99", "--enable=warning,style,performance,portability", "--error-exitcode=1",
          "--inline-suppr", "--quiet", "."], place)


@pytest.mark.slow
@pytest.mark.needs("cppcheck")
def test_misra_remarks_are_counted(folder) -> None:
    """Only counted: which rules are broken on purpose stands in the folder's README."""
    place = folder("patu655_lift", "float")
    said = run(["cppcheck", "--std=c99", "--addon=misra", "--quiet", "."], place)
    rules = Counter(re.findall(r"misra-c2012-([\d.]+)", said.stderr))
    print(f"MISRA C:2012 remarks on patu655_lift: {rules.total()}, by rule {dict(sorted(rules.items()))}")
    assert rules


# the folder by itself

@pytest.mark.parametrize(("machine", "real", "flags"), tiered([
    ("patu655_lift", "double", ()), ("patu655_lift", "float", ()), ("kr300", "float", ("CFLAGS=-O0",)),
    ("cat215b folded", "float", ("CFLAGS=-O0",)), ("spatial", "double", ("CFLAGS=-O0",)),
    *((machine, real, ("CFLAGS=-O0",)) for machine in ("cat215b", "panda_mukca") for real in REALS)],
    lambda machine, real, flags: (machine, real) in QUICK))
def test_folder_tests_itself_by_make(machine: str, real: str, flags: tuple[str, ...], folder, tmp_path: Path) -> None:
    place = copied(folder(machine, real), tmp_path / "elsewhere")
    name = library.subject(machine, real).name
    assert f"{name}: self-test passed" in must(["make", "check", *flags], place)
    must(["make", "clean"], place)
    assert {file.name for file in place.iterdir()} == {file.name for file in folder(machine, real).iterdir()}


@pytest.mark.parametrize(("machine", "real"), tiered([("patu655_lift", "double"), ("cat215b", "float")],
                                                    lambda *case: case in QUICK))
@pytest.mark.slow
@pytest.mark.needs("cmake", "ctest")
def test_folder_tests_itself_by_cmake(machine: str, real: str, folder, tmp_path: Path) -> None:
    place = copied(folder(machine, real), tmp_path / "elsewhere")
    must(["cmake", "-S", ".", "-B", "build"], place)
    must(["cmake", "--build", "build"], place)
    assert "100% tests passed, 0 tests failed out of 1" in must(["ctest", "--test-dir", "build"], place)


def test_self_test_can_be_called_from_another_program(folder, tmp_path: Path) -> None:
    place = copied(folder("patu655_lift", "double"), tmp_path / "elsewhere")
    (place / "other.c").write_text("int patu655_lift_selftest(void);\n"
                                   "int main(void) { return patu655_lift_selftest(); }\n")
    must(["cc", "-std=c99", "-DPATU655_LIFT_NO_MAIN", "-o", "other", "other.c", "patu655_lift_selftest.c",
          "patu655_lift.c", "-lm"], place)
    must(["./other"], place)


@pytest.mark.slow
def test_self_test_fails_if_a_routine_is_wrong(folder, tmp_path: Path) -> None:
    """In every function of the sources its first product is doubled, or its last where the first decides on the status
    alone, such as a length within its stroke.
    """
    place = copied(folder("patu655_lift", "double"), tmp_path / "elsewhere")
    source = place / "patu655_lift.c"
    kept = source.read_text("utf-8")
    places = [found.start() for found in re.finditer(r"^[\w ]+\w\([^;{]*\)\s*\n\{", kept, re.MULTILINE)]
    product = re.compile(r"^( +(?! |const double variance)[^=\n]* = )([^;\n]* \* [^;\n]*);", re.MULTILINE)
    unnoticed, count = [], 0
    for start, end in itertools.pairwise([*places, len(kept)]):
        products = list(product.finditer(kept, start, end))
        count += bool(products)
        for one in dict.fromkeys((*products[:1], *products[-1:])):
            source.write_text(f"{kept[:one.start()]}{one[1]}2.0 * ({one[2]});{kept[one.end():]}", encoding="utf-8")
            done = run(["make", "check", "CFLAGS=-O0"], place)
            if done.returncode != 0 and "self-test failed" in done.stdout:
                break
        else:
            unnoticed += [kept[start : start + 300]] if products else []
    assert count >= 11
    assert not unnoticed
    source.write_text(kept, encoding="utf-8")
    must(["make", "check", "CFLAGS=-O0"], place)


@pytest.mark.parametrize("real", REALS)
def test_self_test_fails_if_a_literal_is_wrong(real: str, folder, tmp_path: Path) -> None:
    place = copied(folder("patu655_lift", real), tmp_path / "elsewhere")
    source = place / "patu655_lift.c"
    kept = source.read_text("utf-8")
    regressor = kept.index("patu655_lift_regressor(")
    literal = next(found for found in re.finditer(r"(?<![\w.\[])\d+\.\d{5,}(?:e-?\d+)?(?![^\n]*return)", kept)
                   if found.start() > regressor)
    digits = f"{float(literal.group()) * 1.1:.9g}"
    source.write_text(kept[:literal.start()] + digits + kept[literal.end():], encoding="utf-8")
    done = run(["make", "check", "CFLAGS=-O0"], place)
    assert done.returncode != 0
    assert "self-test failed" in done.stdout


# the same bytes

@pytest.mark.parametrize("machine", tiered(["patu655_lift", "cat215b"], lambda machine: machine == "patu655_lift"))
def test_texts_are_the_same_however_often_they_are_made(machine: str, folder) -> None:
    again = library.files(library.subject.__wrapped__(machine, "double"))
    assert {file.name: file.read_text("utf-8") for file in folder(machine, "double").iterdir()} == again


@pytest.mark.slow
def test_texts_do_not_depend_on_the_seed_of_hashes(tmp_path: Path) -> None:
    """Through the command, and with the sizes that the compiler here tells."""
    given = ["codegen", "patu655_lift", "-o", str(tmp_path / "one"), "--quiet", "--functions", "inverse_dynamics"]
    seed = "1" if os.environ.get("PYTHONHASHSEED") != "1" else "2"
    must([sys.executable, "-m", "hydroopt", *given], tmp_path, environment={"PYTHONHASHSEED": seed})
    described, origin = read("patu655_lift")
    Code(described, origin, routines=["inverse_dynamics"]).write(tmp_path / "other")
    one, other = ({file.name: file.read_bytes() for file in (tmp_path / name).iterdir()} for name in ("one", "other"))
    assert one == other
    assert "README.md" in one


# sanitizers

@pytest.fixture(scope="session")
def sanitized(folder, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], dict[str, str]]:
    """What self-test and fuzz driver print, built with sanitizers that end the program at the first finding."""
    home = tmp_path_factory.mktemp("sanitized")

    @cache
    def get(subject: str, real: str) -> dict[str, str]:
        place = copied(folder(subject, real), home / f"{subject}_{real}")
        (place / "fuzz.c").write_text(driver(library.subject(subject, real)), encoding="utf-8")
        flags = ["-std=c99", "-O0", *SANITIZE]
        must(["cc", *flags, "-c", *sources(place)], place)
        made = [name.replace(".c", ".o") for name in sources(place) if name != "fuzz.c"]
        name = library.subject(subject, real).name
        must(["cc", *flags, "-o", "selftest", f"{name}_selftest.c", *made, "-lm"], place)
        must(["cc", *flags, "-o", "fuzz", "fuzz.o", *made, "-lm"], place)
        return {"selftest": must(["./selftest"], place), "fuzz": must(["./fuzz"], place)}

    return get


@pytest.mark.parametrize(("machine", "real"), tiered(FUZZED, lambda *case: case in QUICK))
@pytest.mark.slow
def test_sanitizers_find_nothing_in_the_self_test(machine: str, real: str, sanitized) -> None:
    assert "self-test passed" in sanitized(machine, real)["selftest"]


def counted(printed: str) -> dict[tuple[str, str], dict[str, int]]:
    """Counts of a fuzz driver by routine and mode."""
    rows = re.findall(r"^(\w+) (\w+) status((?: \d+)+) unknown (\d+) touched (\d+) infinite (\d+)$", printed, re.M)
    return {(routine, mode): {**dict(zip(STATUSES, map(int, by.split()), strict=True)), "unknown": int(unknown),
                              "touched": int(touched), "infinite": int(infinite)}
            for routine, mode, by, unknown, touched, infinite in rows}


@pytest.mark.parametrize(("machine", "real"), tiered(FUZZED, lambda *case: case in QUICK))
def test_random_inputs_give_a_status_and_a_result_that_fits_it(machine: str, real: str, sanitized) -> None:
    """A status of the list; nothing is written where it says so; finite results where they may be used."""
    counts = counted(sanitized(machine, real)["fuzz"])
    routines = library.subject(machine, real).routines
    assert set(counts) == {(routine, mode) for routine in (*routines, "prepare") for mode in MODES}
    for (routine, mode), count in counts.items():
        assert sum(count[status] for status in STATUSES) == INPUTS // len(MODES)
        assert count["unknown"] == 0, (routine, mode, count)
        # that a triangle has no sides shows in what was prepared of them
        assert count["touched"] <= (count["OPEN_TRIANGLE"] if routine == "prepare" else 0), (routine, mode, count)
        if mode == "bad":
            assert count["NOT_FINITE"] > 0, (routine, count)
        if mode in ("usual", "near"):
            good = list(STATUSES)[OK], list(STATUSES)[OUT_OF_STROKE]
            assert sum(count[status] for status in good) > 0, (routine, mode, count)
    assert not {key: count["infinite"] for key, count in counts.items() if count["infinite"]}
