"""CAT 215B: the generated C bare-metal on a Cortex-M4F, its self-test in an emulator, and what it takes there."""

import re
import shutil
import subprocess
import tempfile
from collections import Counter
from pathlib import Path

from hydroopt import load_machine
from hydroopt.codegen.folder import Code
from hydroopt.codegen.parameter_source import Origin
from hydroopt.codegen.sizes import CORTEX_M4F, sizes

TOOLS = ("arm-none-eabi-gcc", "arm-none-eabi-objdump", "arm-none-eabi-size", "qemu-system-arm", "cppcheck")
DOUBLE = re.compile(r"\.f64|__aeabi_(d|f2d|i2d|ui2d|l2d)\w*|<(sin|cos|sqrt|acos|atan2|pow|fabs)>")
"""What double precision looks like in the machine code: instructions, the compiler's helpers, calls of the library."""

CONTROL = ("forward_kinematics", "cylinder_state", "joint_state", "actuator_forces", "inverse_dynamics",
           "gravity_forces", "regressor", "reduced_regressor", "closure")
CALIBRATION = ("residual", "residual_by_motion", "residual_by_parameters", "residual_by_geometry", "closure",
               "mass_matrix", "wrench_forces", "tip_wrench")


def generated(routines: tuple[str, ...], **options: bool) -> Code:
    """The generator of the folder."""
    machine = load_machine("cat215b")
    origin = Origin("nominal values of the machine cat215b", machine.sha256)
    return Code(machine, origin, routines=routines, single=True, **options)


def doubles(folder: Path) -> int:
    """How many double instructions and calls the routines hold; those of the C library are not looked at."""
    count = 0
    for source in folder.glob("*.c"):
        subprocess.run(["arm-none-eabi-gcc", "-std=c99", "-O2", *CORTEX_M4F, "-c", source.name, "-o", "object.o"],
                       cwd=folder, check=True)
        code = subprocess.run(["arm-none-eabi-objdump", "-dr", "object.o"], cwd=folder, check=True, capture_output=True,
                              text=True).stdout
        count += len(DOUBLE.findall(code))
    return count


def remarks(folder: Path) -> dict[str, int]:
    """Remarks of cppcheck, and of its MISRA C:2012 addon by rule."""
    sources = [path.name for path in folder.glob("*.c") if not path.name.endswith("_selftest.c")]
    said = [subprocess.run(["cppcheck", "--std=c99", option, "--quiet", *sources], cwd=folder, check=True,
                           capture_output=True, text=True).stderr
            for option in ("--enable=warning,style,performance,portability", "--addon=misra")]
    rules = Counter(re.findall(r"misra-c2012-(\d+\.\d+)", said[1]))
    return {"cppcheck": len(re.findall(r": (?:error|warning|style|performance|portability):", said[0])),
            "misra": rules.total()} | {f"misra_{rule}": count for rule, count in sorted(rules.items())}


def run() -> dict | None:
    """Sizes in bytes by routine, and what the checks found; None where a tool is missing."""
    if not all(map(shutil.which, TOOLS)):
        return None
    results: dict = {}
    for name, routines, options in (("", CONTROL, {}), ("_folded", CONTROL, {"fold_geometry": True}),
                                    ("_residuals", CALIBRATION, {})):
        code = generated(routines, **options)
        written = code.files()
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            for file, text in written.items():
                (folder / file).write_text(text, encoding="utf-8")
            results[f"doubles{name}"] = doubles(folder)
            if not name:
                results |= remarks(folder)
        for needs, where in zip(sizes(written | code.bench, single=True), ("", "_m7"), strict=True):
            results[f"selftest{name}{where}"] = 0 if needs.passed else 1
            results[f"program_flash{name}{where}"] = needs.program
            results[f"library{name}{where}"] = " ".join(needs.library)
            results[f"stack_bound_holds{name}{where}"] = all(
                each.used is not None and each.used <= each.stack for each in needs.functions.values())
            for routine, size in needs.functions.items():
                short = f"{routine.removeprefix('cat215b_')}{name}{where}"
                results[short] = f"{size.flash} flash, {size.stack} stack, {size.used} used, {size.instructions} instr"
                if routine == "cat215b_inverse_dynamics":
                    results |= {f"{short}_flash": size.flash, f"{short}_instructions": size.instructions}
    return results
