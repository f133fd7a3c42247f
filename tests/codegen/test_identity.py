"""How generated files tell that they belong together, and which version, interface and estimate they are."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import pytest

from fixtures import library
from fixtures.library import NOT_FINITE, STALE, Library, run, sources, write
from fixtures.tools import Tool
from hydroopt.codegen.folder import INTERFACE_VERSION, LICENCE, Code
from hydroopt.codegen.parameter_source import Origin
from hydroopt.support.packages import version

ROUTINES = ("cylinder_state", "gravity_forces")


@cache
def made(**options: bool) -> Code:
    return library.code(library.machine("cat215b"), routines=ROUTINES, **options)


@pytest.fixture(scope="module")
def folder_of(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(library.files(made()), tmp_path_factory.mktemp("identity") / "c")


def test_every_file_states_that_it_may_be_used_freely() -> None:
    for name, text in library.files(made()).items():
        assert LICENCE in text, name
        assert version() in text, name


def test_the_digest_tells_code_not_values() -> None:
    nominal = library.machine("patu655_lift")
    longer = nominal.with_values({"lift_cylinder.dead_length": 1.01 * nominal.cylinders[0].dead_length})
    lift = library.code(nominal, routines=ROUTINES)
    assert library.code(longer, routines=ROUTINES).digest == lift.digest
    assert library.code(nominal, routines=ROUTINES[:1]).digest != lift.digest
    assert library.code(nominal, routines=ROUTINES, single=True).digest != lift.digest


def test_the_digest_tells_constants_of_valves_that_are_in_the_code() -> None:
    nominal = library.machine("patu655_lift")
    wider = nominal.with_values({"lift_cylinder.dead_band": 0.07})
    assert len({library.code(each, routines=("valve_feedforward",)).digest for each in (nominal, wider)}) == 2


def test_the_library_states_its_version_and_estimate(tmp_path: Path) -> None:
    code = Code(library.machine("cat215b"), Origin("an estimate", "12345678" + "0" * 56), routines=ROUTINES)
    built = Library(code, tmp_path / "c")
    text = ctypes.string_at(ctypes.addressof(ctypes.c_char.in_dll(built._c, "cat215b_version"))).decode()
    assert text == (f"cat215b by hydroopt {version()}, conventions {'.'.join(map(str, INTERFACE_VERSION))}, "
                    f"interface {code.digest}")
    params = (tmp_path / "c" / "cat215b_params.h").read_text("utf-8")
    assert "0x12345678UL, /* estimate */" in params


@pytest.mark.parametrize("flag", ["-ffast-math", "-ffinite-math-only", "-Ofast"])
@pytest.mark.parametrize("compiler", ["cc", Tool("clang")])
def test_compilers_that_drop_checks_for_nan_are_refused(folder_of: Path, compiler: str, flag: str) -> None:
    done = run([compiler, "-std=c99", "-fsyntax-only", flag, "cat215b.c"], folder_of)
    assert "the checks for numbers that are none would go" in done.stderr


@pytest.mark.parametrize("compiler", ["cc", Tool("clang")])
@pytest.mark.parametrize("flags", [("-O3",), ("-O2", "-funsafe-math-optimizations"),
                                   ("-O2", "-fno-signed-zeros", "-fno-math-errno")])
def test_other_optimisations_keep_the_checks_for_nan(folder_of: Path, compiler: str, flags: tuple[str, ...]) -> None:
    main = folder_of.parent / "main.c"
    main.write_text(
        '#include <math.h>\n#include "cat215b_params.h"\nint main(void)\n{\n    static cat215b_constants_t constants;\n'
        "    cat215b_motion_t in = {{0.0, -0.5, 1.4}, {0.0}, {0.0}};\n    cat215b_efforts_t out;\n"
        "    if (cat215b_prepare(&cat215b_values, &constants) != CAT215B_OK) {\n        return 99;\n    }\n"
        "    in.q[1] = NAN;\n    return (int)cat215b_gravity_forces(&constants, &in, &out);\n}\n", encoding="utf-8")
    name = "".join((compiler, *flags))
    done = run([compiler, "-std=c99", *flags, "-I.", "-o", name, main, *sources(folder_of), "-lm"], folder_of)
    assert done.returncode == 0, done.stderr
    assert run([f"./{name}"], folder_of).returncode == NOT_FINITE


@pytest.mark.parametrize("file", ["cat215b.h", "cat215b_params.h"])
def test_files_of_two_generations_do_not_compile(file: str, tmp_path: Path) -> None:
    now, before = write(library.files(made()), tmp_path / "now"), write(
        library.files(made(fold_geometry=True)), tmp_path / "before")
    (now / "main.c").write_text('#include "cat215b_params.h"\n', encoding="utf-8")
    command = ["cc", "-std=c99", "-fsyntax-only", *sources(now), *(["main.c"] if "params" in file else [])]
    assert run(command, now).returncode == 0
    (now / file).write_text((before / file).read_text("utf-8"), encoding="utf-8")
    message = "of another generation" if file == "cat215b.h" else "generated for other sources"
    assert message in run(command, now).stderr


def test_parameters_compiled_against_other_headers_are_stale(tmp_path: Path) -> None:
    """A library of before with a program of now, which the compiler cannot tell."""
    double, now = write(library.files(made()), tmp_path / "before"), write(
        library.files(made(fold_geometry=True)), tmp_path / "now")
    (now / "main.c").write_text(
        '#include "cat215b_params.h"\nint main(void)\n{\n    static double room[4096];\n'
        "    return (int)cat215b_prepare(&cat215b_values, (cat215b_constants_t *)(void *)room);\n}\n", encoding="utf-8")
    done = run(["cc", "-std=c99", "-o", "main", "main.c", *(double / name for name in sources(double)), "-lm"], now)
    assert done.returncode == 0, done.stderr
    assert run(["./main"], now).returncode == STALE
