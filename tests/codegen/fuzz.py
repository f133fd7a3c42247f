"""A C program that calls every routine of a generated machine with all sorts of numbers, and counts what comes back."""

from __future__ import annotations

import numpy as np
from library import NOT_FINITE, NULL_POINTER, OK, OUT_OF_RANGE, OUT_OF_STROKE

from hydroopt.codegen.folder import STATUSES, Code
from hydroopt.machine.geometry import Geometry

INPUTS = 20000
MODES = ("usual", "near", "bad", "tiny", "huge")
"""Numbers of order one; dead points, zeros and limits among them; NaN and infinities; denormals; up to the largest."""

_HEAD = """\
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "{p}.h"
#include "{p}_params.h"

typedef {real} real;
enum {{ INPUTS = {inputs}, MODES = {modes}, STATUSES = {statuses} }};
static const char *const mode_names[MODES] = {{ {names} }};
static const real special[] = {{ {special} }};
static uint64_t state = 88172645463325252ULL;

static uint64_t draw(void)
{{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state >> 11;
}}

static double uniform(void) {{ return (double)draw() / 9007199254740992.0; }}

/* One number of a mode; `scale` is the order of usual ones. */
static real number(int mode, double scale)
{{
    const double usual = scale * (2.0 * uniform() - 1.0);
    const uint64_t way = draw() % 8U;
    switch (mode) {{
    case 1: return way < 4U ? special[draw() % (sizeof(special) / sizeof(special[0]))] : (real)usual;
    case 2: return way == 0U ? (real)NAN : way == 1U ? (real)INFINITY : way == 2U ? -(real)INFINITY : (real)usual;
    case 3: return (real)(way < 4U ? usual * 1e-310 : way < 6U ? usual * (double){smallest} : usual);
    case 4: return (real)(way < 3U ? usual / scale * (double){largest}
                          : way < 6U ? usual * pow(10.0, {most} * uniform()) : usual);
    default: return (real)usual;
    }}
}}

/* Numbers in a row: of the second mode all, of the last three some only. */
static void fill(real *x, size_t n, int mode, double scale)
{{
    const int all = (draw() % 2U) == 0U;
    for (size_t i = 0U; i < n; i++) {{
        x[i] = number((all || mode < 2 || draw() % n == 0U) ? mode : 0, scale);
    }}
}}

static int finite_all(const real *x, size_t n)
{{
    for (size_t i = 0U; i < n; i++) {{
        if (!(fabs((double)x[i]) <= DBL_MAX)) {{
            return 0;
        }}
    }}
    return 1;
}}

static int count[STATUSES], unknown, touched, infinite;

/* What came back: a known status, an untouched result where nothing was written, finite numbers where they count.
 * `strict` tells that nothing may be written without a result, whatever the status. */
static void judge(int status, const void *before, const void *after, size_t size, const real *x, size_t n, int strict)
{{
    if ((status < 0) || (status >= STATUSES)) {{
        unknown++;
        return;
    }}
    count[status]++;
    if ((status == {ok}) || (status == {stroke})) {{
        infinite += !finite_all(x, n);
    }} else if (strict || (status == {null}) || (status == {not_finite}) || (status == {out_of_range})) {{
        touched += memcmp(before, after, size) != 0;
    }}
}}

static void report(const char *routine, int mode)
{{
    printf("%s %s status", routine, mode_names[mode]);
    for (int i = 0; i < STATUSES; i++) {{
        printf(" %d", count[i]);
        count[i] = 0;
    }}
    printf(" unknown %d touched %d infinite %d\\n", unknown, touched, infinite);
    unknown = touched = infinite = 0;
}}

/* Parameters near their nominal values, one of them any number now and then, and what is prepared of them. */
static void parameters({p}_constants_t *constants, int mode)
{{
    {p}_params_t params = {p}_values;
    const size_t n = sizeof(params) / sizeof(real);
    for (size_t i = 0U; (mode != 1) && (i < n); i++) {{ /* dead points are where they are for nominal ones */
        ((real *)(void *)&params)[i] *= (real)(1.0 + 0.02 * (2.0 * uniform() - 1.0));
    }}
    if ((mode != 2) && (draw() % 4U == 0U)) {{
        fill(&((real *)(void *)&params)[draw() % n], 1U, mode, 1.0);
    }}
    (void){p}_prepare(&params, constants);
}}

int main(void)
{{
    {p}_constants_t constants;
    for (int mode = 0; mode < MODES; mode++) {{
"""

_PREPARE = """
        for (int i = 0; i < INPUTS; i++) {{
            {p}_params_t params = {p}_values;
            {p}_constants_t before, after;
            memset(&before, 0xA5, sizeof(before));
            after = before;
            for (size_t k = 0U; k < sizeof(params) / sizeof(real); k++) {{
                if (draw() % 16U == 0U) {{
                    fill(&((real *)(void *)&params)[k], 1U, mode, 10.0);
                }}
            }}
            judge((int){p}_prepare(&params, &after), &before, &after, sizeof(after), {values}, 1);
        }}
        report("prepare", mode);
"""

_ROUTINE = """
        for (int i = 0; i < INPUTS; i++) {{
            {p}_{takes}_t in;
            {p}_{gives}_t before, after;
            if (i % 20 == 0) {{
                parameters(&constants, mode);
            }}
            memset(&before, 0xFF, sizeof(before)); /* NaN, so that what is not written is noticed */
            after = before;
{fills}            judge((int){p}_{name}(&constants, &in, &after), &before, &after, sizeof(after),
                  (const real *)(void *)&after, sizeof(after) / sizeof(real),
                  0);
        }}
        report("{name}", mode);
"""

_PAYLOAD = """
        for (int i = 0; i < INPUTS; i++) {{
            {p}_load_t before, after;
            real std[{P}_BODY_COUNT];
            memset(&before, 0xFF, sizeof(before));
            after = before;
            fill(std, {P}_BODY_COUNT, mode, 1000.0);
            for (int k = 0; (mode == 0) && (k < {P}_BODY_COUNT); k++) {{
                std[k] = std[k] < 0 ? -std[k] : std[k];
            }}
            judge((int){p}_payload_start(std, &after), &before, &after, sizeof(after), (const real *)(void *)&after,
                  sizeof(after) / sizeof(real), 1);
        }}
        report("payload_start", mode);
        for (int i = 0, left = 0; i < INPUTS; i++, left--) {{
            static {p}_load_t load;
            {p}_load_t before;
            {p}_load_sample_t in;
            if (left <= 0) {{
                left = 25;
                real std[{P}_BODY_COUNT];
                parameters(&constants, mode);
                for (int k = 0; k < {P}_BODY_COUNT; k++) {{
                    std[k] = (real)pow(10.0, 4.0 * uniform() - 1.0);
                }}
                (void){p}_payload_start(std, &load);
                load.forgetting = (real)(1.0 - 0.1 * uniform());
            }}
{fills}            if (mode < 2) {{
                for (int k = 0; k < {P}_ACTUATOR_COUNT; k++) {{
                    in.std[k] = (real)pow(10.0, 6.0 * uniform() - 3.0);
                }}
            }}
            if ((mode > 1) && (draw() % 16U == 0U)) {{
                fill(&load.forgetting, 1U, mode, 1.0);
            }}
            if ((mode > 1) && (draw() % 16U == 0U)) {{
                fill(&load.unit[0][0], sizeof(load.unit) / sizeof(real), mode, 2.0);
                fill(load.diagonal, {P}_BODY_COUNT, mode, 1000.0);
                fill(load.prior, {P}_BODY_COUNT, mode, 1000.0);
            }}
            before = load;
            judge((int){p}_payload_update(&constants, &in, &load), &before, &load, sizeof(load),
                  (const real *)(void *)&load, 2U * {P}_BODY_COUNT, 1);
            if ((load.forgetting != before.forgetting) && (before.forgetting == before.forgetting)) {{
                touched++;
            }}
            if (!finite_all((const real *)(void *)&load, sizeof(load) / sizeof(real)) || !(load.forgetting > 0)
                || !(load.forgetting <= 1)) {{
                left = 0; /* begin anew */
            }}
        }}
        report("payload_update", mode);
"""

_LENGTHS = """\
            for (int k = 0; (mode < 2) && (i % 4 != 0) && (k < {P}_CYLINDER_COUNT); k++) {{
                in.length[k] = {p}_values.shortest[k] + ({p}_values.longest[k] - {p}_values.shortest[k])
                               * (real)(1.2 * uniform() - 0.1);
            }}
"""

_SCALES = {"q": 4.0, "qd": 3.0, "qdd": 10.0, "chain_q": 4.0, "fixture": 5.0, "stroke": 1.0, "length": 4.0, "speed": 1.0,
           "reading": 3e7, "force": 1e5, "std": 1e3, "speed_added": 1.0, "force_rate": 1e6, "pressure_a": 3e7,
           "pressure_b": 3e7, "supply": 3e7}


def driver(code: Code) -> str:
    """The program for a machine: a line of counts for every routine and mode."""
    machine, interface = code.interface.machine, code.interface
    special = [0.0, -0.0, 1e-6, -1e-6, np.pi / 2, -np.pi / 2, np.pi, -np.pi, 2 * np.pi, 1.0, -1.0]
    special += [limit for name in machine.joints for limit in machine.link(name).joint.range]
    for cylinder in machine.cylinders:
        special += [cylinder.dead_length, cylinder.dead_length + cylinder.stroke]
        found = Geometry(machine).triangle(cylinder)
        if found is not None:
            offset, fixed, moving = (float(getattr(found[1], key)) for key in ("offset", "fixed", "moving"))
            special += [-offset, np.pi - offset, -np.pi - offset, fixed + moving, abs(fixed - moving)]
    names = {"p": code.name, "P": code.upper, "real": code.type, "inputs": INPUTS // len(MODES), "modes": len(MODES),
             "statuses": len(STATUSES), "names": ", ".join(f'"{mode}"' for mode in MODES),
             "special": ", ".join(f"(real){value!r}" for value in special), "ok": OK, "stroke": OUT_OF_STROKE,
             "null": NULL_POINTER, "not_finite": NOT_FINITE, "out_of_range": OUT_OF_RANGE,
             "largest": "FLT_MAX" if code.single else "DBL_MAX", "smallest": "FLT_MIN" if code.single else "DBL_MIN",
             "most": "37.0" if code.single else "300.0"}

    def fills(struct: str) -> str:
        text = "".join(f"            fill((real *)(void *)&in.{field.name}, sizeof(in.{field.name}) / sizeof(real), "
                       f"mode, {_SCALES[field.name]});\n" for field in interface.structs[struct].fields)
        if any(field.name == "length" for field in interface.structs[struct].fields):
            text += _LENGTHS.format(**names)
        return text

    text = _HEAD.format(**names)
    # what `prepare` made: the numbers after those that are copied may be any, and the last are the strokes
    numbers = len(code.programs[0].outputs[0].entries)
    values = f"(const real *)(void *)&after, {numbers}U" if numbers else "(const real *)NULL, 0U"
    text += _PREPARE.format(**names, values=values)
    for name, routine in code.routines.items():
        if name != "payload_update":
            text += _ROUTINE.format(**names, name=name, takes=routine.takes, gives=routine.gives,
                                    fills=fills(routine.takes))
    if "payload_update" in code.routines:
        text += _PAYLOAD.format(**names, fills=fills("load_sample"))
    return text + "    }\n    return 0;\n}\n"
