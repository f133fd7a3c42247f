"""The scale in C: sample by sample what the scale in Python shows, and never a weight where readings are wrong."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import hydroopt as ho
from fixtures import scale_fuzz
from fixtures.library import NOT_FINITE, OK, OUT_OF_RANGE, write
from fixtures.tiers import tiered
from fixtures.tools import Tool, must
from hydroopt.codegen.folder import scale_code
from hydroopt.codegen.scale_tables import ScaleTables
from hydroopt.model.carried_load import carried_load
from hydroopt.weighing.calibrated_scale import scale
from hydroopt.weighing.course import Weighable, course
from hydroopt.weighing.equations import equations
from hydroopt.weighing.scale import CarriedLoad, Scale, Uncertain
from hydroopt.weighing.smoothed_log import smoothed_log
from hydroopt.weighing.weighing import learned
from studies.weighing.machines import RATE

Array = np.ndarray
STRICT = [
    "-std=c99",
    "-O2",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wshadow",
    "-Wdouble-promotion",
    "-Wstrict-prototypes",
    "-Wcast-qual",
    "-Wundef",
    "-Werror",
]
KNOWN_LOAD = " after a known load"
LOADS = {
    "cat215b": (scale_fuzz.LOADS["cat215b"], 900.0),
    "patu655_lift": (scale_fuzz.LOADS["patu655_lift"], 400.0),
    "wheel_loader": (CarriedLoad("bucket", (0.42, 0.28, 0.0), (0.1, 0.1, 0.1), 1500.0), 900.0),
    "forestry_crane": (CarriedLoad("rotator", (0.0, 0.0, 0.8), (0.1, 0.1, 0.1), 600.0), 300.0),
}
LOADS |= {name + KNOWN_LOAD: each for name, each in LOADS.items()}
TARE = 10.0
DRIVER = """\
#include <stdio.h>
#include "{p}_scale.h"
#include "{p}_params.h"
#include "{p}_scale_params.h"

static {p}_constants_t constants;
static {p}_scale_t scale;

int main(void)
{{
    {p}_scale_sample_t in;
    {p}_scale_reading_t out;
    double given[{P}_JOINT_COUNT + {P}_READING_COUNT + 1];
    if ({p}_prepare(&{p}_values, &constants) != {P}_OK
        || {p}_scale_start(&{p}_scale_values, {tare}, ({real}){roll!r}, 0, ({real})0.052359877559829883,
                           &scale) != {P}_OK) {{
        return 1;
    }}
    while (fread(given, sizeof(given), 1U, stdin) == 1U) {{
        for (int k = 0; k < {P}_JOINT_COUNT; k++) {{
            in.q[k] = ({real})given[k];
        }}
        for (int k = 0; k < {P}_READING_COUNT; k++) {{
            in.reading[k] = ({real})given[{P}_JOINT_COUNT + k];
        }}
        in.step = ({real})given[{P}_JOINT_COUNT + {P}_READING_COUNT];
        const int status = (int){p}_scale_update(&constants, &{p}_scale_values, &in, &scale, &out);
        printf("%d %d %u %u %.17g %.17g %.17g %.17g %.17g %zu\\n", status, (int)out.weighable, (unsigned)out.load,
               (unsigned)(out.fresh * out.sample), (double)out.mass, (double)out.mass_std, (double)out.centre[0],
               (double)out.centre_std[0], (double)out.misfit, sizeof(scale));
    }}
    return 0;
}}
"""


class Shown(NamedTuple):
    """What the C shows after each sample."""

    status: Array
    weighable: list[Weighable | str]
    load: Array
    sample: Array  # number of the smoothed sample, 0 where the last mass is repeated
    numbers: Array  # mass, its deviation, centre x, its deviation, misfit
    size: int


@cache
def subject(machine: str) -> tuple[Scale, ho.Log]:
    """An identified scale, and a log in which a load is picked up at 12 s."""
    model = ho.Model(machine.removesuffix(KNOWN_LOAD))
    load, mass = LOADS[machine]
    truth = ho.random_truth(model, seed=3)
    motions = [
        ho.random_trajectory(model, duration=duration, rate=RATE, seed=k) for k, duration in ((1, 60.0), (2, 24.0))
    ]
    made = scale(model, ho.simulate(model, motions[0], truth, seed=1), load, uncertain=Uncertain(gain=0.004))
    loaded = truth + mass * carried_load(model, load.link, load.centre)[:, 0]
    if machine.endswith(KNOWN_LOAD):
        made = learned(made, ho.simulate(model, motions[1], loaded, seed=5), mass, 2.0)
    before, after = (ho.simulate(model, motions[1], psi, seed=4) for psi in (truth, loaded))
    here = motions[1].t >= 12.0
    return made, ho.Log(
        "work",
        before.t,
        {name: np.where(here, after.channel(name), before.channel(name)) for name in before.channels},
        units=before.units,
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Shown]:
    @cache
    def program(machine: str, real: str) -> tuple[Path, tuple[str, ...]]:
        made, folder = (
            scale_code(subject(machine)[0], 1 / RATE, single=real == "float"),
            tmp_path_factory.mktemp("scale"),
        )
        for name, text in made.files().items():
            (folder / name).write_text(text, encoding="utf-8")
        (folder / "main.c").write_text(
            DRIVER.format(
                p=made.name, P=made.upper, real=real, tare=TARE, roll=float(made.interface.machine.orientation[0])
            ),
            encoding="utf-8",
        )
        sources = sorted(path.name for path in folder.glob("*.c") if not path.name.endswith(("_selftest.c", "main.c")))
        for source in sources:
            subprocess.run(["cc", *STRICT, "-c", source], cwd=folder, check=True)
        subprocess.run(
            ["cc", "-std=c99", "-O1", "-o", "main", "main.c", *(f"{name[:-2]}.o" for name in sources), "-lm"],
            cwd=folder,
            check=True,
        )
        machine_file = made.interface.machine
        return folder / "main", (
            *(f"{joint}.q" for joint in machine_file.joints),
            *made.interface.kinds["reading"].names,
        )

    def run(machine: str, real: str, log: ho.Log, **changed: Array) -> Shown:
        path, channels = program(machine, real)
        columns = [changed.get(name, log.channel(name)) for name in channels]
        columns.append(changed.get("step", np.full(log.size, 1 / RATE)))
        printed = subprocess.run(
            [path], input=np.column_stack(columns).astype(float).tobytes(), capture_output=True, check=True
        ).stdout.decode()
        rows = np.array([line.split() for line in printed.splitlines()], dtype=float)
        return Shown(
            rows[:, 0].astype(int),
            [ScaleTables.status(int(each)) for each in rows[:, 1]],
            rows[:, 2],
            rows[:, 3],
            rows[:, 4:9],
            int(rows[0, 9]),
        )

    return run


@pytest.mark.parametrize(
    ("machine", "real"),
    tiered(
        [(machine, real) for machine in LOADS for real in ("double", "float")],
        lambda machine, real: (machine, real)
        in [("patu655_lift", "float"), ("patu655_lift" + KNOWN_LOAD, "double")],
    ),
)
def test_it_shows_what_python_shows(machine: str, real: str, run: Callable[..., Shown]) -> None:
    made, log = subject(machine)
    load, mass = LOADS[machine]
    shown = run(machine, real, log)
    readings = list(course(equations(made, smoothed_log(made.model, log)), tare=TARE, needed=0.02 * load.full_scale))
    assert set(shown.status) == {OK}
    # the samples of the tare are taken twice, and the second time some in a call
    place = {int(number) - 1: k for k, number in enumerate(shown.sample) if number > 0}
    taring = round(TARE * 5)
    assert set(range(taring + 5, len(readings))) < set(place)
    assert max(place) == len(readings) - 1
    some = [i for i in sorted(place) if i >= taring - 1]
    found = [place[i] for i in some]
    assert [shown.weighable[k] for k in found] == [readings[i].status for i in some]
    assert shown.load[found].tolist() == [readings[i].load for i in some]
    said = np.array([(each.weighed.mass, each.weighed.mass_std, each.weighed.misfit) for each in readings])[some]
    off = np.abs(shown.numbers[found][:, [0, 1, 4]] - said)[1:] / [load.full_scale, load.full_scale, 1.0]
    # misfits, which are judged by a factor of three, are small differences of large sums
    masses, misfits = {"double": (1e-9, 1e-9), "float": (5e-6, 5e-4)}[real]
    assert np.max(off[:, :2]) < masses
    assert np.max(off[:, 2]) < misfits
    first = {int(number) - 1: k for k, number in reversed([*enumerate(shown.sample)]) if number > 0}
    for i in range(taring - 1):
        assert shown.weighable[first[i]] == readings[i].status
        assert shown.numbers[first[i], 4] == pytest.approx(readings[i].weighed.misfit, rel=1e-3, abs=1e-3)
    last = readings[-1].weighed
    assert abs(last.mass - mass) < 4 * last.mass_std
    assert shown.numbers[-1, 2] - load.centre[0] == pytest.approx(last.phi[1] / last.phi[0], abs=1e-4)
    assert shown.size == ScaleTables(made, 1 / RATE, 1.0).state_size(single=real == "float")


SWAPS = {"swapped": "boom_cylinder.p_head", "bars": "boom_cylinder.p_head", "sign": "stick.q", "units": "boom.q"}


@pytest.mark.slow
@pytest.mark.parametrize("fault", SWAPS)
def test_wrong_readings_never_count_as_weights(fault: str, run: Callable[..., Shown]) -> None:
    _, log = subject("cat215b")
    head, rod = (log.channel(f"boom_cylinder.{end}") for end in ("p_head", "p_rod"))
    changed = {
        "swapped": {"boom_cylinder.p_head": rod, "boom_cylinder.p_rod": head},
        "bars": {"boom_cylinder.p_head": head / 14.5, "boom_cylinder.p_rod": rod / 14.5},
        "sign": {"stick.q": -log.channel("stick.q")},
        "units": {"boom.q": np.degrees(log.channel("boom.q"))},
    }[fault]
    shown = run("cat215b", "float", log, **changed)
    assert Weighable.OK not in shown.weighable
    # what is refused, such as a posture that is none, shows no weight either
    assert all(shown.weighable[k] == ScaleTables.status(8) for k in np.flatnonzero(shown.status != OK))


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
@pytest.mark.parametrize("channel", ["boom.q", "boom_cylinder.p_head", "step"])
def test_numbers_that_are_none_are_refused_and_smoothing_begins_anew(
    channel: str, bad: float, run: Callable[..., Shown]
) -> None:
    _, log = subject("cat215b")
    values = np.full(log.size, 1 / RATE) if channel == "step" else log.channel(channel).copy()
    values[1000] = bad
    shown = run("cat215b", "float", log, **{channel: values})
    assert np.flatnonzero(shown.status == NOT_FINITE).tolist() == [1000]
    assert shown.weighable[1000] == ScaleTables.status(8)
    kept = ScaleTables(*subject("cat215b")[:1], 1 / RATE, 1.0).kernel
    assert set(shown.weighable[1001 : 1001 + 2 * kept.margin]) == {ScaleTables.status(1)}
    assert np.all(np.isfinite(shown.numbers))
    assert shown.weighable[-1] is Weighable.OK
    assert abs(shown.numbers[-1, 0] - LOADS["cat215b"][1]) < 4 * shown.numbers[-1, 1]


def test_gaps_and_other_rates_weigh_nothing(run: Callable[..., Shown]) -> None:
    _, log = subject("cat215b")
    assert Weighable.OK not in run("cat215b", "float", log, step=np.full(log.size, 0.04)).weighable
    none = run("cat215b", "float", log, step=np.zeros(log.size))
    assert set(none.status) == {OUT_OF_RANGE}
    assert set(none.weighable) == {ScaleTables.status(8)}


def test_a_machine_that_stands_shows_no_weight(run: Callable[..., Shown]) -> None:
    _, log = subject("cat215b")
    held = {
        name: np.concatenate([log.channel(name)[:800], np.full(log.size - 800, log.channel(name)[800])])
        for name in log.channels
    }
    shown = run("cat215b", "float", log, **held)
    assert not {Weighable.OK} & set(shown.weighable[950:])
    assert Weighable.STANDSTILL in shown.weighable or Weighable.CHANGING in shown.weighable


STALENESS = """\
#include "cat215b_scale.h"
#include "cat215b_params.h"
#include "cat215b_scale_params.h"
static cat215b_constants_t constants;
static cat215b_scale_t scale;
static cat215b_scale_params_t params;
static cat215b_scale_reading_t out;
int main(void)
{
    const cat215b_scale_sample_t in = {{0}, {0}, 0.02f};
    int wrong = 0;
    params = cat215b_scale_values;
    wrong += cat215b_prepare(&cat215b_values, &constants) != CAT215B_OK;
    wrong += cat215b_scale_update(&constants, &params, &in, &scale, &out) != CAT215B_STALE; /* not started */
    wrong += out.weighable != CAT215B_SCALE_REFUSED;
    wrong += cat215b_scale_start(&params, 10.0f, 0.0f, 0.0f, 0.0f, &scale) != CAT215B_OUT_OF_RANGE;
    wrong += cat215b_scale_start(&params, -1.0f, 0.0f, 0.0f, 0.1f, &scale) != CAT215B_OUT_OF_RANGE;
    wrong += cat215b_scale_start(&params, 60.0f, 0.0f, 0.0f, 0.1f, &scale) != CAT215B_OUT_OF_RANGE;
    wrong += cat215b_scale_start(&params, 10.0f, 1.5f, 0.0f, 0.1f, &scale) != CAT215B_OUT_OF_RANGE;
    wrong += cat215b_scale_start(NULL, 10.0f, 0.0f, 0.0f, 0.1f, &scale) != CAT215B_NULL_POINTER;
    wrong += cat215b_scale_start(&params, 10.0f, 0.0f, 0.0f, 0.1f, &scale) != CAT215B_OK;
    params.estimate++; /* of another calibration than the constants */
    wrong += cat215b_scale_update(&constants, &params, &in, &scale, &out) != CAT215B_STALE;
    params.estimate--;
    params.interface++; /* of other code */
    wrong += cat215b_scale_update(&constants, &params, &in, &scale, &out) != CAT215B_STALE;
    wrong += cat215b_scale_start(&params, 10.0f, 0.0f, 0.0f, 0.1f, &scale) != CAT215B_STALE;
    params.interface--;
    constants.interface++;
    wrong += cat215b_scale_update(&constants, &params, &in, &scale, &out) != CAT215B_STALE;
    constants.interface--;
    out.weighable = CAT215B_SCALE_WEIGHABLE;
    wrong += cat215b_scale_update(&constants, &params, NULL, &scale, &out) != CAT215B_NULL_POINTER;
    wrong += out.weighable != CAT215B_SCALE_REFUSED;
    params.columns[3][2] = 0.0f / 0.0f;
    wrong += cat215b_scale_start(&params, 10.0f, 0.0f, 0.0f, 0.1f, &scale) != CAT215B_NOT_FINITE;
    return wrong;
}
"""


def test_stale_and_mismatched_parameters_are_refused(tmp_path: Path) -> None:
    made = scale_code(subject("cat215b")[0], 1 / RATE, single=True)
    for name, text in made.files().items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "main.c").write_text("#include <stddef.h>\n" + STALENESS, encoding="utf-8")
    sources = sorted(path.name for path in tmp_path.glob("*.c") if not path.name.endswith("_selftest.c"))
    subprocess.run(["cc", "-std=c99", "-o", "main", *sources, "-lm"], cwd=tmp_path, check=True)
    assert subprocess.run([tmp_path / "main"], check=False).returncode == 0
    # headers of two generations do not compile together
    header = (tmp_path / "cat215b_scale.h").read_text("utf-8")
    (tmp_path / "cat215b_scale.h").write_text(re.sub(r"(SCALE_INTERFACE) 0x\w+", r"\1 0x1UL", header), encoding="utf-8")
    refused = subprocess.run(
        ["cc", "-std=c99", "-c", "cat215b_scale.c"], cwd=tmp_path, capture_output=True, check=False
    )
    assert b"generate all again" in refused.stderr
    refused = subprocess.run(
        ["cc", "-std=c99", "-Ofast", "-ffast-math", "-c", "cat215b_scale.c"],
        cwd=tmp_path,
        capture_output=True,
        check=False,
    )
    assert b"#error" in refused.stderr


BUILDS = {
    "sanitizers": ("-O1", "-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"),
    "-O3": ("-O3",),
    "unsafe": ("-O2", "-funsafe-math-optimizations"),
    "associative": ("-O3", "-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math", "-freciprocal-math"),
}
"""Flags of compilers; the last two are those that change arithmetic and keep infinities and NaN."""


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    home = tmp_path_factory.mktemp("fuzzed")

    @cache
    def folder(real: str) -> Path:
        made = scale_fuzz.identified("patu655_lift", real)
        place = write(made.files() | {"fuzz.c": scale_fuzz.driver(made)}, home / real)
        (place / f"{made.name}_selftest.c").unlink()
        return place

    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flags", "compiler"), [("sanitizers", "cc"), *((flags, compiler) for flags in [*BUILDS][1:]
                                                     for compiler in ("cc", Tool("clang")))]
)
@pytest.mark.parametrize("real", ["double", "float"])
def test_random_samples_show_a_status_and_a_mass_that_fits_it(
    flags: str, real: str, compiler: str, fuzzed: Callable[[str], Path], tmp_path: Path
) -> None:
    """Whatever it is fed: a refused sample shows no mass, numbers are finite, and a mass that counts is one."""
    sources = sorted(fuzzed(real).glob("*.c"))
    must([compiler, "-std=c99", *BUILDS[flags], "-o", "fuzz", *sources, "-lm"], tmp_path)
    rows = [line.split() for line in must(["./fuzz"], tmp_path).splitlines()]
    assert [row[0] for row in rows] == list(scale_fuzz.MODES)
    for mode, _, *counts in rows:
        status, wrong = [int(word) for word in counts[: counts.index("shown")]], counts[-1]
        assert wrong == "0", (mode, counts)
        assert sum(status) == scale_fuzz.SAMPLES // len(scale_fuzz.MODES)
        assert status[NOT_FINITE] > 0 or mode != "bad"
        assert status[OK] > 0


@pytest.mark.needs("arm-none-eabi-gcc", "qemu-system-arm")
def test_all_it_needs_on_a_controller_is_measured() -> None:
    made = scale_code(subject("patu655_lift")[0], 1 / RATE, single=True, measured=True)
    readme = made.files()["README.md"]
    rows = re.findall(r"`patu655_lift_scale_update` \| (\d+) \| (\d+) \| (\d+) \| (\d+)", readme)
    for stack, used, _, instructions in rows:
        assert 0 < int(used) <= int(stack)
        assert 10_000 < int(instructions) < 1_000_000
    assert f"{made.scale.state_size(single=True)} bytes" in readme


def test_scales_that_have_no_c_are_refused() -> None:
    made = subject("patu655_lift")[0]
    for step, needed in ((1e-4, 20.0), (1.0, 20.0), (float("nan"), 20.0), (0.02, 0.0)):
        with pytest.raises(ho.ProblemError, match="a scale in C needs a sampling step"):
            scale_code(made, step, needed=needed)
