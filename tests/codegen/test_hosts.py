"""What integrators' tools take beside the C: components like those of ros2_control, an S-function, structured text.

None of these tools is here. The components are compiled with interfaces like those that ros2_control lends, the
S-function with as much of Simulink's header as it uses, and both run. Structured text is parsed by blark, a grammar of
IEC 61131-3 as TwinCAT and CODESYS extend it; that its structs have C's layout is computed from the text.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from blark import parse

from fixtures import library
from fixtures.library import NOT_FINITE, OK, Library, write
from fixtures.tiers import tiered
from fixtures.tools import Tool, must
from hydroopt.cli.codegen import codegen
from hydroopt.codegen import self_test
from hydroopt.codegen.folder import Code
from hydroopt.codegen.hosts import HOSTS

STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Werror"]
SIMULINK = Path(__file__).parents[1] / "fixtures" / "simulink"
PAIRS = [("patu655_lift", "double"), ("patu655_lift", "float"), ("cat215b", "double"), ("kr300", "float"),
         ("backhoe", "double")]
CASES = tiered(PAIRS, lambda subject, real: subject == "patu655_lift")
Folders = Callable[[str, str], tuple[Code, Path]]


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Folders:
    """The generator of a machine and its folder with the files of all hosts."""
    home = tmp_path_factory.mktemp("hosts")

    @cache
    def get(subject: str, real: str) -> tuple[Code, Path]:
        made = library.code(library.machine(subject), single=real == "float",
                            hosts=("ros2_control", "simulink", "codesys"))
        return made, write(library.files(made), home / f"{subject}_{real}")

    return get


def library_sources(made: Code, place: Path) -> list[str]:
    """C files of the folder but for the self-test and those of hosts."""
    return [name for name in library.sources(place) if name.startswith(made.name)
            and not name.endswith(("_sfun.c", "_codesys.c"))]


def test_the_command_names_all_hosts() -> None:
    assert all(name in codegen.__annotations__["hosts"].__metadata__[0].help for name in HOSTS)


@pytest.mark.parametrize("name", HOSTS)
def test_every_host_is_told_in_the_readme(name: str) -> None:
    made = library.code(library.machine("patu655_lift"), routines=("inverse_dynamics",), hosts=(name,))
    texts = library.files(made)
    for file in HOSTS[name].files:
        assert file.format(p="patu655_lift") in texts["README.md"]


# ros2_control

LENT = """\
#include <cstdio>
#include <limits>
#include <optional>
#include <string>
#include <vector>
#include "{p}_ros2_control.hpp"
#include "{p}_params.h"

namespace control = hydroopt::{p}::ros2_control;

struct Older {{
    double value = 0;
    double get_value() const {{ return value; }}
    void set_value(double x) {{ value = x; }}
}};
struct Newer {{
    double value = 0;
    template <class T = double> [[nodiscard]] std::optional<T> get_optional() const {{ return value; }}
    [[nodiscard]] bool set_value(double x) {{ value = x; return true; }}
}};

template <class T> double value_of(const T &x) {{ return x.value; }}
template <> double value_of(const double &x) {{ return x; }}

template <class Interface> int driven()
{{
    using component = control::component<control::inverse_dynamics>;
    component made({p}_values);
    std::vector<Interface> states(component::state_interfaces.size());
    std::vector<Interface> commands(component::command_interfaces.size());
    if (!made.on_configure() || std::string(component::state_interfaces[0]) != "{first}/position") {{
        return 1;
    }}
    control::detail::write(states[0], 0.25);
    if (made.update(states, commands) != control::return_type::ok) {{
        return 2;
    }}
    for (const auto &each : commands) {{
        std::printf("%.17g ", value_of(each));
    }}
    std::puts("");
    const double before = value_of(commands[0]);
    control::detail::write(states[0], std::numeric_limits<double>::quiet_NaN());
    if (made.update(states, commands) != control::return_type::error
        || made.state() != hydroopt::{p}::status::not_finite || value_of(commands[0]) != before) {{
        return 3;
    }}
    return 0;
}}

int main()
{{
    return driven<Older>() + driven<Newer>() + driven<double>();
}}
"""


@pytest.mark.parametrize("compiler", [Tool("g++"), Tool("clang++")])
def test_components_read_and_write_lent_interfaces(compiler: str, folders: Folders) -> None:
    made, place = folders("patu655_lift", "double")
    (place / "lent.cpp").write_text(LENT.format(p=made.name, first="lift"), encoding="utf-8")
    must(["cc", "-std=c99", "-c", "patu655_lift.c"], place)
    must([compiler, "-std=c++17", *STRICT, "-fno-exceptions", "-o", compiler, "lent.cpp", "patu655_lift.o",
          "-lm"], place)
    model = made.interface.complete
    expected = float(model.inverse_dynamics(0.25, 0.0, 0.0, model.parameters.nominal))
    assert np.allclose(np.array(must([f"./{compiler}"], place).split(), float), expected, rtol=1e-12)


@pytest.mark.needs("g++")
@pytest.mark.parametrize(("subject", "real"), CASES)
def test_components_compile_and_name_what_they_exchange(subject: str, real: str, folders: Folders) -> None:
    made, place = folders(subject, real)
    text = (place / f"{subject}_ros2_control.hpp").read_text("utf-8")
    must(["g++", "-std=c++17", *STRICT, "-fsyntax-only", "-x", "c++", f"{subject}_ros2_control.hpp"], place)
    joints, actuators = made.interface.machine.joints, [a.name for a in made.interface.machine.actuators]
    own = text[text.index("struct inverse_dynamics {"):]
    names = re.findall(r'"(\S+/\S+)"', own[:own.index("status call")])
    assert names[:3 * len(joints)] == [f"{joint}/{key}" for key in ("position", "velocity", "acceleration")
                                       for joint in joints]
    assert {f"{each}/effort" for each in actuators} <= set(names) or not made.interface.machine.one_each


# Simulink

def routine_numbers(place: Path, name: str) -> dict[str, int]:
    text = (place / f"{name}_sfun.c").read_text("utf-8")
    return {routine: int(number) for number, routine in re.findall(r"^ \* (\d+) (\w+): reads", text, re.MULTILINE)}


@pytest.mark.parametrize(("subject", "real"), CASES)
def test_the_s_function_computes_what_the_library_computes(subject: str, real: str, folders: Folders) -> None:
    made, place = folders(subject, real)
    must(["cc", "-std=c99", *STRICT, f"-I{SIMULINK}", "-O0", "-o", "sfun", f"{subject}_sfun.c",
          *library_sources(made, place), "-lm"], place)
    lib = Library(library.subject(subject, real), place.parent / f"lib_{subject}_{real}", "-O0")
    numbers = routine_numbers(place, subject)
    assert set(numbers) == set(made.routines)
    values = {key: array for key, array in self_test.states(lib.interface, 1, seed=3, single=made.single).items()
              if array.ndim == 2}
    for name, number in numbers.items():
        routine = made.routines[name]
        status, expected = lib.call(name, lib.prepare(), values, 1)
        given = np.concatenate([values[key].ravel() for key in routine.reads])
        done = subprocess.run([place / "sfun", str(number)], input="\n".join(map(repr, given.tolist())), text=True,
                              capture_output=True, check=False)
        assert done.returncode == 0, (name, done.stdout, done.stderr)
        widths, first, second = (np.array(line.split(), float) for line in done.stdout.splitlines())
        assert widths.tolist() == [values[key].size for key in routine.reads]
        assert first[-1] == status[0]
        if status[0] == OK:
            said = np.concatenate([expected[key].ravel() for key in routine.outputs])
            assert np.array_equal(first[:-1], said)
        assert second[-1] == NOT_FINITE
        assert np.array_equal(second[:-1], first[:-1])


def test_the_s_function_refuses_a_number_that_is_no_routine(folders: Folders) -> None:
    made, place = folders("patu655_lift", "double")
    must(["cc", "-std=c99", f"-I{SIMULINK}", "-o", "sfun", "patu655_lift_sfun.c", *library_sources(made, place),
          "-lm"], place)
    done = subprocess.run([place / "sfun", "99"], input="", text=True, capture_output=True, check=False)
    assert done.returncode == 1
    assert "the parameter is the number of a routine" in done.stdout


# structured text

def structs(text: str) -> dict[str, list[tuple[str, int, int]]]:
    """Members of all structs: name, size of a number and how many."""
    found = {}
    for name, body in re.findall(r"^TYPE (\w+) :\nSTRUCT\n(.*?)^END_STRUCT", text, re.MULTILINE | re.DOTALL):
        found[name] = []
        for member, bounds, kind in re.findall(r"^    (\w+) : (?:ARRAY\[([^\]]*)\] OF )?(\w+);", body, re.MULTILINE):
            count = int(np.prod([int(last) + 1 for last in re.findall(r"0\.\.(\d+)", bounds)] or [1]))
            found[name].append((member, {"LREAL": 8, "REAL": 4, "UDINT": 4}[kind], count))
    return found


def layout(members: list[tuple[str, int, int]]) -> list[int]:
    """Offsets of all members, each aligned to its own size, and the size of the struct."""
    offsets, at = [], 0
    for _, size, count in members:
        at += -at % size
        offsets.append(at)
        at += size * count
    return [*offsets, at + -at % max(size for _, size, _ in members)]


@pytest.mark.parametrize(("subject", "real"), CASES)
def test_structured_text_has_the_layout_of_c(subject: str, real: str, folders: Folders) -> None:
    made, place = folders(subject, real)
    told = structs((place / f"{subject}.st").read_text("utf-8"))
    assert set(told) == {f"{subject}_constants_t", *(f"{subject}_{name}_t" for name in made.used
                                                    if name != "params")}
    offsets = "".join(
        "    " + " ".join(f'printf("%zu ", offsetof({name}, {member.removesuffix("_digest")}));'
                          for member, _, _ in members) + f' printf("%zu\\n", sizeof({name}));\n'
        for name, members in told.items())
    (place / "layout.c").write_text(f'#include <stddef.h>\n#include <stdio.h>\n#include "{subject}.h"\n'
                                    f"int main(void)\n{{\n{offsets}    return 0;\n}}\n", encoding="utf-8")
    must(["cc", "-std=c99", "-o", "layout", "layout.c"], place)
    said = [list(map(int, line.split())) for line in must(["./layout"], place).splitlines()]
    assert said == [layout(members) for members in told.values()]


@pytest.mark.slow
@pytest.mark.parametrize(("subject", "real"), tiered(
    PAIRS, lambda subject, real: (subject, real) == ("patu655_lift", "double")))
def test_structured_text_is_parsed(subject: str, real: str, folders: Folders) -> None:
    made, place = folders(subject, real)
    items = parse.parse_source_code((place / f"{subject}.st").read_text("utf-8")).transform().items
    functions = {str(each.name) for each in items if type(each).__name__ == "Function"}
    assert functions == {f"{subject}_iec_{name}" for name in (*made.routines, "prepare")}


def test_a_misspelt_declaration_is_not_parsed() -> None:
    text = "FUNCTION f : DINT\nVAR_INPUT\n    a : POINTR TO DINT;\nEND_VAR\nEND_FUNCTION\n"
    assert parse.parse_source_code(text).exception is not None
    assert parse.parse_source_code(text.replace("POINTR", "POINTER")).exception is None


@pytest.mark.parametrize("compiler", ["cc", Tool("clang")])
def test_functions_of_structured_text_are_those_of_the_library(compiler: str, folders: Folders) -> None:
    made, place = folders("patu655_lift", "double")
    (place / "plc.c").write_text(
        '#include <stdio.h>\n#include "patu655_lift_codesys.c"\nint main(void)\n{\n'
        "    static patu655_lift_constants_t constants;\n    patu655_lift_motion_t given = {{0.25}, {0.5}, {-0.125}};\n"
        "    patu655_lift_efforts_t made;\n"
        "    patu655_lift_iec_prepare_struct prepare = {&constants, PATU655_LIFT_STALE};\n"
        "    patu655_lift_iec_inverse_dynamics_struct call = {&constants, &given, &made, PATU655_LIFT_STALE};\n"
        "    patu655_lift_iec_inverse_dynamics(&call);\n    if (call.result != PATU655_LIFT_STALE) {\n"
        "        return 1;\n    }\n    patu655_lift_iec_prepare(&prepare);\n"
        "    patu655_lift_iec_inverse_dynamics(&call);\n"
        '    printf("%.17g\\n", made.force[0]);\n    return (int)(prepare.result + call.result);\n}\n',
        encoding="utf-8")
    must([compiler, "-std=c99", *STRICT, "-o", "plc", "plc.c", *library_sources(made, place), "-lm"], place)
    model = made.interface.complete
    expected = float(model.inverse_dynamics(0.25, 0.5, -0.125, model.parameters.nominal))
    assert float(must(["./plc"], place)) == pytest.approx(expected, rel=1e-12)
