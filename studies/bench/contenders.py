"""Ways to evaluate a machine's regressor in C, each compiled into a loop over samples."""

import ctypes
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt import Machine, Model, load_machine
from hydroopt.codegen.folder import Code
from hydroopt.codegen.parameter_source import read
from hydroopt.kernels import compiler as system
from hydroopt.kernels.expression_graph import program
from hydroopt.kernels.native import CACHED, Runner, room, source

KEPT = 512
"""Results that the loop in C keeps before it writes over them."""
SAMPLES = 40 * KEPT
FLAGS = tuple(flag for flag in system.FLAGS if flag != "-w")
CONTROLLER = ("-std=c99", "-O2", "-fPIC", "-shared")
LOOP = Path(__file__).with_name("loop.c").read_text()


class Contender(NamedTuple):
    """A compiled loop; `rows` and `columns` of the regressor are what it writes at each sample, in this order."""

    run: Callable[..., None]
    rows: np.ndarray
    columns: np.ndarray
    by_entry: bool = False
    """Whether results stand in memory as the kernels' do, samples side by side."""

    def over(self, state: list[np.ndarray], out: np.ndarray, kept: int = KEPT) -> None:
        self.run(len(state[0]), kept, *(array.ctypes.data for array in (*state, out)))

    def room(self, kept: int = KEPT) -> np.ndarray:
        made = room(kept, (1, len(self.rows)))[0][:, 0] if self.by_entry else np.empty((kept, len(self.rows)))
        made[:] = np.nan
        return made


class Regressor:
    """The regressor of a bundled machine at random motions, and what is built from it in a folder."""

    def __init__(self, name: str, folder: str) -> None:
        self.machine, self.folder = load_machine(name), folder
        self.model = Model(self.machine)
        self.function: ca.Function = self.model.regressor
        self.state = motions(self.machine, SAMPLES)
        self.expected = Runner().over(self.function, *self.state)[0]

    def casadi(self, flags: tuple[str, ...] = FLAGS) -> dict[str, Contender]:
        """CasADi's own C of the expressions as they are written, and after hydroopt simplified them."""
        written = ca.Function("as_written", [*self.model.coordinates], [self.model.dynamics.regressor()])
        return {"CasADi, as written": self.generated(written, flags),
                "CasADi, simplified": self.generated(self.function, flags)}

    def parametric(self, flags: tuple[str, ...]) -> Contender:
        """CasADi's own C with the geometry as an argument, as the exported C has it."""
        own = Code(self.machine, read(self.machine.name)[1]).interface
        given = [own.inputs[name] for name in ("q", "qd", "qdd", "geometry")]
        function = ca.Function("parametric", given, [own.dynamics.regressor()])
        return self.generated(function, flags, own.values["geometry"])

    def generated(self, function: ca.Function, flags: tuple[str, ...], more: np.ndarray | None = None) -> Contender:
        """CasADi's own C of a function of a motion, and perhaps of numbers that stay the same."""
        generator = ca.CodeGenerator("function")
        generator.add(function)
        given, before = "in", ""
        if more is not None:
            given = "(const double *[]){in[0], in[1], in[2], more}"
            before = f"static const double more[] = {{{', '.join(map(repr, more.tolist()))}}};"
        return self.built({"function.c": generator.dump()}, f"{function.name()}({given}, into, 0, 0, 0);", before,
                          flags=flags, places=function.sparsity_out(0).get_triplet())

    def kernel(self) -> Contender:
        """The kernel that serves whole logs, called for as many samples at once as are kept."""
        n = len(self.machine.joints)
        return self.built({"kernel.c": source(program(self.function))},
                          f"over(n - s < kept ? n - s : kept, in, stride, into, step, 8 * SIZE * *step > {CACHED}, 0);",
                          f"const long stride[] = {{{n}, {n}, {n}}}, step[] = {{((kept + 7) / 8 | 1) * 8}};",
                          step="kept", by_entry=True)

    def exported(self, flags: tuple[str, ...], *, fold_geometry: bool) -> Contender:
        """The controller's C."""
        code = Code(*read(self.machine.name), routines=["regressor"], fold_geometry=fold_geometry)
        name = code.name
        files = {file: text for file, text in code.files().items() if "selftest" not in file}
        files["loop.c"] = f'#include <string.h>\n#include "{name}_params.h"\n'
        copy = " ".join(f"memcpy(motion.{part}, in[{k}], sizeof motion.{part});"
                        for k, part in enumerate(("q", "qd", "qdd")))
        return self.built(files, f"{copy} {name}_regressor(&constants, &motion, ({name}_regressor_t *)into[0]);",
                          f"{name}_motion_t motion; {name}_constants_t constants; "
                          f"{name}_prepare(&{name}_values, &constants);", flags=flags)

    def built(self, files: Mapping[str, str], call: str, before: str = "", *, step: str = "1",
              flags: tuple[str, ...] = FLAGS, places: tuple[list[int], list[int]] | None = None,
              by_entry: bool = False) -> Contender:
        """Compile some files, the last with the loop added to it; what comes out must be what the library gives."""
        rows, columns = np.indices(self.expected.shape[1:]).reshape(2, -1) if places is None else np.array(places)
        words = {"STEP": step, "BEFORE": before, "CALL": call, "SIZE": len(rows), "JOINTS": len(self.machine.joints)}
        folder = Path(tempfile.mkdtemp(dir=self.folder))
        for file, text in files.items():
            (folder / file).write_text(text + LOOP * (file == [*files][-1]))
        by = compiler()
        subprocess.run([*by.command, *flags, "-w", *(f"-D{word}={text}" for word, text in words.items()),
                        *(str(folder / file) for file in files if file.endswith(".c")),
                        "-o", str(folder / "run.so"), *by.libraries], check=True)
        run = ctypes.CDLL(str(folder / "run.so")).run
        run.argtypes = [ctypes.c_long, ctypes.c_long, *[ctypes.c_void_p] * 4]
        made = Contender(run, rows, columns, by_entry)
        out = made.room(SAMPLES)
        made.over(self.state, out, SAMPLES)
        expected, left = self.expected[:, rows, columns], np.isnan(out[0])  # the kernel leaves constants alone
        assert not np.ptp(expected[:, left], axis=0).any()
        assert np.allclose(out[:, ~left], expected[:, ~left], rtol=1e-9, atol=1e-9)
        return made


def motions(machine: Machine, count: int) -> list[np.ndarray]:
    """Random q, q̇ and q̈ (count, n), positions within the joints' ranges."""
    rng = np.random.default_rng(1)
    lower, upper = machine.ranges.T
    return [rng.uniform(lower, upper, (count, len(lower))), *rng.uniform(-1, 1, (2, count, len(lower)))]


def compiler() -> system.Compiler:
    found = system.compiler()
    if found is None:
        raise SystemExit("without a compiler there is nothing to measure")
    return found


def toolchain() -> str:
    """Compiler and what it is told."""
    by = compiler()
    version = subprocess.run([*by.command, "--version"], capture_output=True, text=True, check=True).stdout
    return f"{version.splitlines()[0]}, linked with {' '.join(by.libraries)}; CasADi {ca.__version__}"
