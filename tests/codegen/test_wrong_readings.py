"""Bad input under every flag of compilers that the documentation names: a status, never a wrong number with OK.

One program feeds the generated C with what goes wrong on machines: signs, units, exchanged pressures, stale or mixed
parameters, numbers that are none. It is built with each compiler and flag; the flags under which the checks would go do
not compile.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fixtures import library
from fixtures.library import sources, write
from fixtures.tiers import tiered
from fixtures.tools import Tool, must
from hydroopt.codegen.folder import STATUSES

FLAGS = {
    "plain": ("-O0",), "-O1": ("-O1",), "-O2": ("-O2",), "-O3": ("-O3",), "-Os": ("-Os",),
    "native": ("-O3", "-march=native"), "unsafe": ("-O2", "-funsafe-math-optimizations"),
    "associative": ("-O3", "-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math", "-freciprocal-math"),
    "no errno": ("-O2", "-fno-math-errno")}
"""By name; the last three are those that change arithmetic and keep infinities and NaN."""
ROUTINES = ("actuator_forces", "inverse_dynamics", "residual", "tip_wrench", "valve_feedforward", "joint_state")
CASES = tiered([(subject, real, compiler, flags) for subject in ("patu655_lift", "cat215b")
                for real in ("double", "float") for compiler in ("cc", Tool("clang")) for flags in FLAGS],
               lambda subject, real, compiler, flags: subject == "patu655_lift" and (
                   real == "float") == (compiler == "clang"))

PROGRAM = """\
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "{p}.h"
#include "{p}_params.h"

typedef {type} real;
static {p}_constants_t constants;
static {p}_motion_t motion;
static {p}_measurement_t measured;
static {p}_demand_t demand;

/* What came back, and whether the result is as it was before. */
static void told(const char *what, int status, const void *result, size_t size)
{{
    unsigned char before[4096];
    memset(before, 0x5A, size);
    printf("%s: %d %s\\n", what, status, memcmp(before, result, size) == 0 ? "untouched" : "written");
}}

static void forces(const char *what, const {p}_constants_t *by)
{{
    {p}_efforts_t out;
    int status;
    memset(&out, 0x5A, sizeof(out));
    status = (int){p}_inverse_dynamics(by, &motion, &out);
    told(what, status, &out, sizeof(out));
    if (status == 0) {{
        for (size_t k = 0; k < sizeof(out) / sizeof(real); k++) {{
            printf("%.17g ", (double)((const real *)(const void *)&out)[k]);
        }}
        printf("\\n");
    }}
}}

static void residuals(const char *what)
{{
    {p}_residual_t out;
    {p}_tip_wrench_t wrench;
    int status;
    memset(&out, 0x5A, sizeof(out));
    memset(&wrench, 0x5A, sizeof(wrench));
    status = (int){p}_residual(&constants, &measured, &out);
    told(what, status, &out, sizeof(out));
    status = (int){p}_tip_wrench(&constants, &measured, &wrench);
    told(what, status, &wrench, sizeof(wrench));
}}

static void valves(const char *what)
{{
    {p}_commands_t out;
    memset(&out, 0x5A, sizeof(out));
    told(what, (int){p}_valve_feedforward(&constants, &demand, &out), &out, sizeof(out));
}}

int main(void)
{{
    const real bad[3] = {{(real)NAN, (real)INFINITY, -(real)INFINITY}};
    {p}_params_t params = {p}_values;
    {p}_constants_t none;
    memset(&none, 0, sizeof(none));
    forces("not prepared", &constants);
    if ({p}_prepare(&params, &constants) != {P}_OK) {{
        return 1;
    }}
    {{
        const real q[] = {{ {q} }};
        memcpy(motion.q, q, sizeof(q));
        memcpy(measured.q, q, sizeof(q));
        memcpy(demand.q, q, sizeof(q));
    }}
    for (size_t k = 0; k < sizeof(measured.reading) / sizeof(real); k++) {{
        measured.reading[k] = (real)5e6;
    }}
    for (size_t k = 0; k < sizeof(demand.pressure_a) / sizeof(real); k++) {{
        demand.pressure_a[k] = demand.pressure_b[k] = (real)5e6;
        demand.factor_extending[k] = demand.factor_retracting[k] = (real)1;
    }}
    demand.supply[0] = (real)2e7;
    demand.supply[1] = (real)2e5;
    forces("good", &constants);
    residuals("good");
    valves("good");
    for (int b = 0; b < 3; b++) {{
        for (int k = 0; k < {P}_JOINT_COUNT; k++) {{
            const real held = motion.q[k];
            motion.q[k] = bad[b];
            forces("not finite", &constants);
            motion.q[k] = held;
            motion.qdd[k] = bad[b];
            forces("not finite", &constants);
            motion.qdd[k] = 0;
        }}
        measured.reading[0] = bad[b];
        residuals("not finite");
        measured.reading[0] = (real)5e6;
        demand.supply[1] = bad[b];
        valves("not finite");
        demand.supply[1] = (real)2e5;
    }}
    motion.q[{turned}] = -motion.q[{turned}];
    forces("angle of the wrong sign", &constants);
    motion.q[{turned}] = -motion.q[{turned}] * (real)57.29578;
    forces("degrees", &constants);
    for (size_t k = 0; k < sizeof(measured.reading) / sizeof(real); k++) {{
        if (measured.reading[k] > 0) {{
            measured.reading[k] = -measured.reading[k];
            residuals("pressure of the wrong sign");
            measured.reading[k] = -measured.reading[k];
        }}
    }}
    demand.pressure_b[0] = -demand.pressure_b[0];
    valves("pressure of the wrong sign");
    demand.pressure_b[0] = -demand.pressure_b[0];
    demand.supply[0] = (real)2e5;
    demand.supply[1] = (real)2e7;
    valves("supply and tank exchanged");
    demand.supply[0] = (real)2e7;
    demand.supply[1] = (real)2e5;
    demand.factor_extending[0] = 0;
    valves("factor that was never set");
    forces("constants of zeros", &none);
    params.interface++;
    told("parameters of other code", (int){p}_prepare(&params, &none), &params, 0);
    forces("parameters of other code", &none);
    params.interface--;
    params.psi[0] = (real)NAN;
    told("parameters that are none", (int){p}_prepare(&params, &none), &params, 0);
    forces("parameters that are none", &none);
    return 0;
}}
"""
EXPECTED = {
    "not prepared": "STALE", "not finite": "NOT_FINITE", "angle of the wrong sign": "OUT_OF_STROKE",
    "degrees": "OUT_OF_RANGE", "pressure of the wrong sign": "OUT_OF_RANGE", "supply and tank exchanged": "NO_SUPPLY",
    "factor that was never set": "OUT_OF_RANGE", "constants of zeros": "STALE", "parameters of other code": "STALE"}
"""A status that nothing hides; what is not listed here has several."""
NOTHING_WRITTEN = ("STALE", "NOT_FINITE", "OUT_OF_RANGE")
POSTURES = {"patu655_lift": ([1.2], 0), "cat215b": ([0.3, -1.046, 1.4], 1)}
"""Where a machine is, and the joint whose angle is out of its cylinder's stroke with the other sign."""
Folders = Callable[[str, str], Path]


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Folders:
    home = tmp_path_factory.mktemp("bad")

    @cache
    def get(subject: str, real: str) -> Path:
        made = library.code(library.machine(subject), single=real == "float", routines=ROUTINES)
        place = write(library.files(made), home / f"{subject}_{real}")
        posture, turned = POSTURES[subject]
        (place / "main.c").write_text(PROGRAM.format(
            p=made.name, P=made.upper, type=real, q=", ".join(f"(real){value!r}" for value in posture),
            turned=turned), encoding="utf-8")
        return place

    return get


@pytest.mark.parametrize(("subject", "real", "compiler", "flags"), CASES)
def test_bad_input_has_a_status_under_all_flags(subject: str, real: str, compiler: str, flags: str,
                                                folders: Folders) -> None:
    place, name = folders(subject, real), "".join((compiler, *FLAGS[flags]))
    must([compiler, "-std=c99", *FLAGS[flags], "-o", name, "main.c",
          *(each for each in sources(place) if each != "main.c"), "-lm"], place)
    printed = must([f"./{name}"], place)
    found = re.findall(r"^(.*): (\d+) (untouched|written)$", printed, re.MULTILINE)
    assert {what for what, _, _ in found} == {"good", "parameters that are none", *EXPECTED}
    for what, number, state in found:
        status = list(STATUSES)[int(number)]
        if what == "good":
            assert (status, state) == ("OK", "written")
            continue
        assert status != "OK", what
        assert status == EXPECTED.get(what, status), what
        if status in NOTHING_WRITTEN:
            assert state == "untouched", what
    numbers = [float(each) for each in printed.partition("good: 0 written\n")[2].splitlines()[0].split()]
    model = library.subject(subject, real).interface.complete
    q = library.held(np.array(POSTURES[subject][0])) if real == "float" else np.array(POSTURES[subject][0])
    expected = np.asarray(model.inverse_dynamics(q, 0 * q, 0 * q, model.parameters.nominal)).ravel()
    assert np.allclose(numbers, expected, rtol=1e-11 if real == "double" else 2e-5,
                       atol=(1e-11 if real == "double" else 2e-5) * np.abs(expected).max())


@pytest.mark.parametrize("flag", ["-ffast-math", "-ffinite-math-only", "-Ofast"])
@pytest.mark.parametrize("compiler", ["cc", Tool("clang")])
def test_flags_that_drop_the_checks_do_not_compile(compiler: str, flag: str, folders: Folders) -> None:
    place = folders("patu655_lift", "double")
    done = subprocess.run([compiler, "-std=c99", flag, "-c", "patu655_lift.c", "-o", "never.o"], cwd=place,
                          capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "the checks for numbers that are none would go" in done.stderr
    assert not (place / "never.o").exists()


@pytest.mark.slow
def test_exchanged_chambers_show_in_the_residual_alone(libraries) -> None:
    """One sample cannot tell them from a load: the status is OK, and the residual the force of twice the difference."""
    lib = libraries("cat215b", "double", "-O0")
    constants, names = lib.prepare(), lib.interface.kinds["reading"].names
    head, rod = (names.index(f"boom_cylinder.p_{side}") for side in ("head", "rod"))
    state = {"q": np.array([[0.3, -0.9, 1.4]]), "qd": np.zeros((1, 3)), "qdd": np.zeros((1, 3)),
             "wrench": np.zeros((1, 6))}
    reading = np.full((1, len(names)), 5e6)
    reading[0, head], reading[0, rod] = 1.2e7, 1e6
    exchanged = reading.copy()
    exchanged[0, [head, rod]] = reading[0, [rod, head]]
    place = [a.name for a in lib.interface.machine.actuators].index("boom_cylinder")
    right, wrong = (lib.call("residual", constants, {**state, "reading": each}, 1)[1]["residual"][0, place]
                    for each in (reading, exchanged))
    assert abs(wrong - right) > 2e5
