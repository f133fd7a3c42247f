"""The generated folder as a CMake package, and its C++ header, used from an empty folder as an integrator would."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fixtures import library
from fixtures.library import run, write
from fixtures.tiers import tiered
from fixtures.tools import Tool, must
from hydroopt.codegen import folder
from hydroopt.codegen.folder import INTERFACE_VERSION
from hydroopt.errors import ProblemError

STRICT = "-Wall -Wextra -Wpedantic -Wconversion -Wsign-conversion -Wshadow -Wdouble-promotion -Werror"
COMPILERS = (("cc", Tool("g++")), (Tool("clang"), Tool("clang++")))
MAJOR, MINOR = INTERFACE_VERSION
USE = """\
#include <cstdio>
#include <limits>
#include "{p}.hpp"
#include "{p}_params.h"

namespace machine = hydroopt::{p};

int main()
{{
    const machine::model model({p}_values);
    machine::motion_t in;
    in.q[0] = {real}(0.25);
    in.qd[0] = {real}(0.5);
    in.qdd[0] = {real}(-0.125);
    const auto made = model.inverse_dynamics(in);
    if (model.prepared() != machine::status::ok || !made) {{
        return 1;
    }}
    std::printf("%.17g\\n", static_cast<double>(made.value.force[{P}_ACTUATOR_LIFT_CYLINDER]));
    in.q[0] = std::numeric_limits<{real}>::quiet_NaN();
    machine::efforts_t kept;
    kept.force[0] = {real}(7);
    if (model.inverse_dynamics(in, kept) != machine::status::not_finite || kept.force[0] != {real}(7)) {{
        return 2;
    }}
    std::puts(machine::text(machine::status::stale));
    {p}_params_t other = {p}_values;
    other.interface++;
    return machine::model(other).prepared() == machine::status::stale ? 0 : 4;
}}
"""
PROJECT = """\
cmake_minimum_required(VERSION 3.10)
project(use CXX)
set(CMAKE_CXX_STANDARD 17)
find_package({p} {version} REQUIRED)
add_executable(use use.cpp)
target_link_libraries(use {p}::{p})
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Where the package of a machine was installed to."""
    home = tmp_path_factory.mktemp("packages")

    @cache
    def get(subject: str, real: str, compiler: str) -> Path:
        name = f"{subject}_{real}_{compiler}"
        made = library.code(library.machine(subject), single=real == "float", hosts=("cpp",))
        place, prefix = write(library.files(made), home / name / "c"), home / name / "prefix"
        must(["cmake", "-S", ".", "-B", "build", f"-DCMAKE_C_COMPILER={compiler}",
              f"-DCMAKE_INSTALL_PREFIX={prefix}", "-DCMAKE_INSTALL_LIBDIR=lib",
              "-DCMAKE_C_FLAGS=-O0 " + STRICT], place)
        must(["cmake", "--build", "build"], place)
        must(["cmake", "--install", "build"], place)
        return prefix

    return get


def project(place: Path, subject: str, real: str, version: str = f"{MAJOR}.{MINOR}") -> Path:
    place.mkdir()
    (place / "CMakeLists.txt").write_text(PROJECT.format(p=subject, version=version), encoding="utf-8")
    (place / "use.cpp").write_text(USE.format(p=subject, P=subject.upper(), real=real), encoding="utf-8")
    return place


@pytest.mark.needs("cmake")
@pytest.mark.parametrize(("compiler", "beside", "real"), tiered(
    [(*pair, real) for pair in COMPILERS for real in ("double", "float")],
    lambda compiler, _, real: (compiler, real) in {("cc", "double"), ("clang", "float")}))
def test_the_package_is_found_built_and_right_from_an_empty_folder(
        compiler: str, beside: str, real: str, installed, tmp_path: Path) -> None:
    place = project(tmp_path / "use", "patu655_lift", real)
    must(["cmake", "-S", ".", "-B", "build", f"-DCMAKE_PREFIX_PATH={installed('patu655_lift', real, compiler)}",
          f"-DCMAKE_CXX_COMPILER={beside}",
          f"-DCMAKE_CXX_FLAGS={STRICT} -Wold-style-cast -fno-exceptions -fno-rtti"], place)
    must(["cmake", "--build", "build"], place)
    force, said = must(["build/use"], place).splitlines()
    model = library.subject("patu655_lift", real).interface.complete
    expected = float(model.inverse_dynamics(0.25, 0.5, -0.125, model.parameters.nominal))
    assert float(force) == pytest.approx(expected, rel=1e-12 if real == "double" else 1e-5)
    assert said.startswith("parameters or constants belong to other code")


@pytest.mark.needs("cmake", "g++")
@pytest.mark.parametrize(("version", "found"), [
    (f"{MAJOR}", True), (f"{MAJOR}.{MINOR}", True), (f"{MAJOR}.{MINOR + 1}", False), (f"{MAJOR + 1}.0", False),
    (f"{MAJOR - 1}.9", False)])
def test_the_package_is_found_by_its_major_version_alone(version: str, found: bool, installed, tmp_path: Path) -> None:
    place = project(tmp_path / "use", "patu655_lift", "double", version)
    done = run(["cmake", "-S", ".", "-B", "build",
                f"-DCMAKE_PREFIX_PATH={installed('patu655_lift', 'double', 'cc')}"], place)
    assert (done.returncode == 0) == found, done.stderr
    assert found or f'compatible with requested version "{version}"' in " ".join(done.stderr.split())


@pytest.mark.needs("cmake")
def test_nothing_but_headers_library_and_package_is_installed(installed) -> None:
    prefix = installed("patu655_lift", "double", "cc")
    there = {str(file.relative_to(prefix)) for file in prefix.rglob("*") if file.is_file()}
    package = "lib/cmake/patu655_lift/patu655_lift-config"
    assert there == {"include/patu655_lift.h", "include/patu655_lift.hpp", "include/patu655_lift_params.h",
                     "lib/libpatu655_lift.a", f"{package}.cmake", f"{package}-noconfig.cmake",
                     f"{package}-version.cmake"}


@pytest.mark.parametrize(("compiler", "subject"), tiered(
    [(compiler, subject) for compiler in (Tool("g++"), Tool("clang++")) for subject in ("cat215b", "backhoe", "kr300")],
    lambda compiler, subject: (compiler, subject) == ("g++", "cat215b")))
def test_the_header_compiles_for_every_struct_and_routine(compiler: str, subject: str, tmp_path: Path) -> None:
    made = library.code(library.machine(subject), hosts=("cpp",))
    place = write(library.files(made), tmp_path / "c")
    (place / "all.cpp").write_text(
        f'#include "{subject}.hpp"\n#include "{subject}_params.h"\nusing namespace hydroopt::{subject};\n'
        f"int main()\n{{\n    const model all({subject}_values);\n" + "".join(
            f"    if (!all.{name}({routine.takes}_t{{}})) {{\n        return 1;\n    }}\n"
            for name, routine in made.routines.items())
        + "    return 0;\n}\n", encoding="utf-8")
    must([compiler, "-std=c++17", "-fsyntax-only", *STRICT.split(), "-fno-exceptions", "all.cpp"], place)


@pytest.mark.needs("g++")
def test_a_program_of_another_generation_does_not_compile(tmp_path: Path) -> None:
    place = write(library.files(library.code(library.machine("patu655_lift"), hosts=("cpp",))), tmp_path / "c")
    header = place / "patu655_lift.h"
    digest = library.subject("patu655_lift", "double").digest
    header.write_text(header.read_text("utf-8").replace(f"0x{digest}UL", "0x1UL"), encoding="utf-8")
    done = run(["g++", "-std=c++17", "-fsyntax-only", "patu655_lift.hpp"], place)
    assert "generated for other sources" in done.stderr


@pytest.mark.needs("g++")
def test_arrays_are_those_of_c(tmp_path: Path) -> None:
    """Rows and columns in the same order."""
    made = library.code(library.machine("patu655_lift"), hosts=("cpp",), routines=("forward_kinematics",))
    place = write(library.files(made), tmp_path / "c")
    (place / "order.cpp").write_text(
        '#include <cstdio>\n#include "patu655_lift.hpp"\n#include "patu655_lift_params.h"\nint main()\n{\n'
        "    hydroopt::patu655_lift::motion_t in;\n    in.q[0] = 0.25;\n"
        "    const auto made = hydroopt::patu655_lift::model(patu655_lift_values).forward_kinematics(in);\n"
        "    for (const auto &row : made.value.pose[0]) {\n        for (const double x : row) {\n"
        '            std::printf("%.17g ", x);\n        }\n    }\n    return made ? 0 : 1;\n}\n', encoding="utf-8")
    must(["g++", "-std=c++17", "-o", "order", "order.cpp", "-x", "c", "patu655_lift.c", "-lm"], place)
    found = np.array(must(["./order"], place).split(), float).reshape(4, 4)
    model = library.subject("patu655_lift", "double").interface.complete
    assert np.allclose(found, np.asarray(model.forward_kinematics(0.25)[0]), rtol=0, atol=1e-12)


def test_unknown_hosts_are_refused() -> None:
    with pytest.raises(ProblemError, match="no host 'abap'"):
        library.code(library.machine("patu655_lift"), hosts=("abap",))




def test_routines_that_compilers_find_too_long_are_compiled_with_less_effort(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Unless whoever calls `make` says which flags; and all others as before."""
    routines = ("forward_kinematics", "inverse_dynamics")
    monkeypatch.setattr(folder, "LARGE", 0)
    made = library.code(library.machine("patu655_lift"), routines=routines)
    short, long = sorted(routines, key=lambda name: len(made.bodies[name]))
    monkeypatch.setattr(folder, "VAST", len(made.bodies[long]) - 1)
    place = write(library.files(made), tmp_path / "c")
    for said, flags in ((), "-O2 -O1"), (("CFLAGS=-O3",), "-O3"):
        commands = must(["make", "-n", *said], place).splitlines()
        (own,) = [each for each in commands if " -c " in each and long in each]
        assert f" {flags} -c " in own
        (other,) = [each for each in commands if " -c " in each and short in each]
        assert f" {said[0][7:] if said else '-O2'} -c " in other
