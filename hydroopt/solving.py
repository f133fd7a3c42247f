"""The one verb: from a problem of any kind to its answer."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, overload

from hydroopt.errors import ProblemError

if TYPE_CHECKING:
    from hydroopt.estimation.combined.estimate import CombinedEstimate, CombinedProblem
    from hydroopt.estimation.dynamic.estimate import Estimate
    from hydroopt.estimation.dynamic.problem import IdentificationProblem
    from hydroopt.estimation.hydraulic.estimate import HydraulicEstimate
    from hydroopt.estimation.hydraulic.problem import HydraulicProblem
    from hydroopt.estimation.kinematic.calibration import Calibration
    from hydroopt.estimation.kinematic.problem import CalibrationProblem
    from hydroopt.estimation.motion.problem import SensorProblem
    from hydroopt.estimation.motion.sensor_calibration import SensorCalibration
    from hydroopt.excitation.motion.excitation import Excitation
    from hydroopt.excitation.motion.problem import ExcitationProblem
    from hydroopt.excitation.selection.calibrator_design import CalibratorDesign
    from hydroopt.excitation.selection.calibrator_problem import CalibratorProblem
    from hydroopt.excitation.selection.measure_up import MeasureUpPlan, MeasureUpProblem
    from hydroopt.excitation.selection.pose_plan import PosePlan
    from hydroopt.excitation.selection.pose_problem import PoseProblem
    from hydroopt.excitation.selection.what_next import WhatNext
    from hydroopt.excitation.selection.what_next_problem import WhatNextProblem

SOLVERS = {
    ("hydroopt.estimation.combined.estimate", "CombinedProblem"): (
        "hydroopt.estimation.combined.estimate", "identify_with_geometry"),
    ("hydroopt.estimation.dynamic.problem", "IdentificationProblem"): (
        "hydroopt.estimation.dynamic.identify", "identify"),
    ("hydroopt.estimation.kinematic.problem", "CalibrationProblem"): (
        "hydroopt.estimation.kinematic.calibration", "calibrate"),
    ("hydroopt.estimation.motion.problem", "SensorProblem"): (
        "hydroopt.estimation.motion.sensor_calibration", "calibrate_sensors"),
    ("hydroopt.estimation.hydraulic.problem", "HydraulicProblem"): (
        "hydroopt.estimation.hydraulic.estimate", "identify_hydraulics"),
    ("hydroopt.excitation.motion.problem", "ExcitationProblem"): ("hydroopt.excitation.motion.design", "design"),
    ("hydroopt.excitation.selection.pose_problem", "PoseProblem"): (
        "hydroopt.excitation.selection.exchange", "fedorov_exchange"),
    ("hydroopt.excitation.selection.measure_up", "MeasureUpProblem"): (
        "hydroopt.excitation.selection.measure_up", "fewest_readings"),
    ("hydroopt.excitation.selection.calibrator_problem", "CalibratorProblem"): (
        "hydroopt.excitation.selection.calibrator_design", "design_calibrator"),
    ("hydroopt.excitation.selection.what_next_problem", "WhatNextProblem"): (
        "hydroopt.excitation.selection.what_next", "plan_next")}
"""Module and name of each kind of problem's solver: only that of the problem at hand is imported."""


@overload
def solve(problem: IdentificationProblem, method: str = ..., **options: Any) -> Estimate: ...
@overload
def solve(problem: CombinedProblem, method: str = ..., **options: Any) -> CombinedEstimate: ...
@overload
def solve(problem: CalibrationProblem, method: str = ..., **options: Any) -> Calibration: ...
@overload
def solve(problem: SensorProblem) -> SensorCalibration: ...
@overload
def solve(problem: HydraulicProblem, **options: Any) -> HydraulicEstimate: ...
@overload
def solve(problem: ExcitationProblem, **options: Any) -> Excitation: ...
@overload
def solve(problem: PoseProblem, **options: Any) -> PosePlan: ...
@overload
def solve(problem: MeasureUpProblem, **options: Any) -> MeasureUpPlan: ...
@overload
def solve(problem: CalibratorProblem, **options: Any) -> CalibratorDesign: ...
@overload
def solve(problem: WhatNextProblem, **options: Any) -> WhatNext: ...


def solve(problem: Any, *arguments: Any, **options: Any) -> Any:
    """Solve a problem; the problem itself is not changed.

    Args:
        problem: identification, kinematic calibration, both together, sensors, valves and oil, the design of a motion
            or of poses, a measure-up, a calibrator, or what to measure next.
        arguments: a method, where the problem has several.
        options: of `hydroopt.estimation.dynamic.identify.identify`,
            `hydroopt.estimation.kinematic.calibration.calibrate`,
            `hydroopt.estimation.combined.estimate.identify_with_geometry`,
            `hydroopt.estimation.hydraulic.estimate.identify_hydraulics`, `hydroopt.excitation.motion.design.design`,
            `hydroopt.excitation.selection.exchange.fedorov_exchange`,
            `hydroopt.excitation.selection.measure_up.fewest_readings`,
            `hydroopt.excitation.selection.calibrator_design.design_calibrator` or
            `hydroopt.excitation.selection.what_next.plan_next`.

    Raises:
        ProblemError: this is no problem that hydroopt can solve, or what the solver of its kind says.
        SolverError, IdentifiabilityError: as the solver of its kind says.

    >>> import hydroopt
    >>> model = hydroopt.Model(hydroopt.load_machine("patu655_lift"))
    >>> log = hydroopt.simulate(model, hydroopt.random_trajectory(model, duration=10, rate=20, seed=1))
    >>> estimate = hydroopt.solve(hydroopt.identification_problem(model, [log]), "wls")
    >>> estimate.method
    'wls'
    """
    for kind in type(problem).__mro__:
        if place := SOLVERS.get((kind.__module__, kind.__name__)):
            module, name = place
            return getattr(import_module(module), name)(problem, *arguments, **options)
    raise ProblemError(f"a {type(problem).__name__} cannot be solved", where="solve",
                       remedy=f"give one of {', '.join(name for _, name in SOLVERS)}")
