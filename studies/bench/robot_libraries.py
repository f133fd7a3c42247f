"""The regressor of a serial arm by other libraries: Pinocchio from Python and in C++, figaroh."""

import ctypes
import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pinocchio as pin

from hydroopt import Machine

LOOP = Path(__file__).with_name("pinocchio.cpp")
FLAGS = ("-O3", "-march=native", "-std=c++17", "-DNDEBUG", "-fPIC", "-shared", "-w", "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
         "-DBOOST_MPL_LIMIT_LIST_SIZE=30", "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
         "-DBOOST_FUSION_INVOKE_MAX_ARITY=10")
"""Those of Boost as Pinocchio's CMake file and headers state them."""
State = list[np.ndarray]


def tree(machine: Machine) -> pin.Model:
    """A serial arm of revolute joints; a regressor needs no masses."""
    made = pin.Model()
    made.gravity.linear = np.array([0.0, 0.0, -machine.gravity])
    joint, end = 0, pin.SE3.Identity()
    for link in machine.links:
        own = link.joint
        start = end * pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, own.theta), np.array([0.0, 0.0, own.d]))
        joint = made.addJoint(joint, pin.JointModelRZ(), start, link.name)
        end = pin.SE3(pin.rpy.rpyToMatrix(own.alpha, 0.0, 0.0), np.array([own.a, 0.0, 0.0]))
    return made


def contenders(machine: Machine, state: State, expected: np.ndarray, folder: str) -> dict[str, Callable[[], object]]:
    """Runs over all samples of a state, by name; those that do not install here are named and left out.

    `expected` (6, 10·n) is what all must give at the first sample.
    """
    model = tree(machine)
    rows = list(zip(*state, strict=True))
    data = model.createData()
    assert np.allclose(pin.computeJointTorqueRegressor(model, data, *rows[0]), expected)
    runs: dict[str, Callable[[], object]] = {
        f"Pinocchio {pin.__version__} from Python": lambda: [pin.computeJointTorqueRegressor(model, data, *row)
                                                              for row in rows]}
    eigen = [found for place in ("/usr", *(Path(path, "cmeel.prefix") for path in sys.path))
             if (found := Path(place, "include", "eigen3")).is_dir()]
    if shutil.which("c++") and eigen:
        runs[f"Pinocchio {pin.__version__} in C++, {' '.join(FLAGS[:2])}"] = _compiled(model, machine, state, expected,
                                                                                      folder, eigen[0])
    else:
        print("Pinocchio in C++ is left out: it needs a C++ compiler and Eigen's headers (pip install cmeel-eigen)")
    module = _figaroh()
    if module:
        robot = SimpleNamespace(model=model, data=data)
        runs["figaroh"] = lambda: module.build_regressor_basic(
            robot, *state, {"act_idxv": list(range(model.nv))})
    else:
        print("figaroh is left out: it is not installed (pip install figaroh)")
    return runs


def _compiled(model: pin.Model, machine: Machine, state: State, expected: np.ndarray, folder: str,
              eigen: Path) -> Callable[[], object]:
    prefix = next(Path(path, "cmeel.prefix") for path in sys.path
                  if Path(path, "cmeel.prefix", "include", "pinocchio").is_dir())
    library = Path(folder) / "pinocchio.so"
    subprocess.run(["c++", *FLAGS, f"-I{prefix}/include", f"-I{eigen}", str(LOOP), "-o", str(library),
                    f"-L{prefix}/lib", "-lpinocchio_default", f"-Wl,-rpath,{prefix}/lib"], check=True)
    run = ctypes.CDLL(str(library)).run
    run.argtypes = [*[ctypes.c_long] * 3, ctypes.c_double, *[ctypes.c_void_p] * 5]
    n, count, kept = len(machine.joints), len(state[0]), 512
    places = np.array([place.homogeneous for place in list(model.jointPlacements)[1:]])
    out = np.full((kept, 10 * n, n), np.nan)

    def over() -> None:
        run(count, kept, n, machine.gravity, places.ctypes.data, *(x.ctypes.data for x in state), out.ctypes.data)

    run(1, kept, n, machine.gravity, places.ctypes.data, *(x.ctypes.data for x in state), out.ctypes.data)
    assert np.allclose(out[0].T, expected)
    return over


def _figaroh() -> ModuleType | None:
    """Its module of regressors alone, since the package loads viewers."""
    package = importlib.util.find_spec("figaroh")
    if package is None or not package.submodule_search_locations:
        return None
    file = Path(package.submodule_search_locations[0], "tools", "regressor.py")
    spec = importlib.util.spec_from_file_location("figaroh_regressor", file)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
