"""Kinematic calibration as an optimisation problem: poses of closed chains, and what is unknown in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Never

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference import listing
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.estimation.kinematic.initial_guesses import placed
from hydroopt.estimation.kinematic.maximum_likelihood import nonlinear_program
from hydroopt.estimation.kinematic.pose_equations import PoseEquations, PoseLoss
from hydroopt.estimation.kinematic.pose_layout import LayoutBuilder, PoseLayout
from hydroopt.logs.frames import all_of
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model.closed_chain import recent_chain
from hydroopt.support.notebook_card import Shown

UNFILLED = "fill in what the sensors and instruments read at each pose"
"""Remedy for a table of poses that was not measured."""


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationProblem(PoseEquations, Shown):
    """What is to be calibrated from which poses, with the attributes of `PoseEquations`; solving never changes it.

    >>> import hydroopt, numpy as np
    >>> machine = hydroopt.load_machine("panda_mukca")
    >>> plan = hydroopt.solve(hydroopt.pose_problem(machine, 20), candidates=50)
    >>> problem = hydroopt.calibration_problem(machine, plan.postures)
    >>> print(str(problem).splitlines()[0])
    calibration of panda_mukca: 40 poses of plan for panda_mukca
    >>> problem.nlp()
    NonlinearProgram(316 variables, 0 fixed numbers, 0 constraints)
    >>> held = problem.fixing(**{"tip.x": 0.0}).with_loss("huber")
    >>> held.loss, len(held.without(np.arange(40) < 5).poses)
    ('huber', 35)
    """

    def nlp(self) -> NonlinearProgram:
        """The program of the method ``joint`` in CasADi: ``solve(problem)`` has the same optimum.

        Variables are the estimated parameters in SI, then the angles of the poses that are read with errors or move
        unsensed, such as ``pose 3: yoke.q``; loops without play close as constraints.
        """
        return nonlinear_program(self)

    def cvxpy(self) -> Never:
        """Refused.

        Raises:
            ProblemError: always: the rows are not convex in the geometry.
        """
        raise ProblemError("a kinematic calibration is not convex and has no convex program",
                           where=f"calibration of {self.model.machine.name}", remedy="use nlp() or hydroopt.solve")

    def __repr__(self) -> str:
        return (f"<CalibrationProblem of {self.model.machine.name}: {int(self.free.sum())} parameters from "
                f"{len(self.poses)} poses>")

    def __str__(self) -> str:
        layout = self.layout
        rows = self.model.loop_rows
        closed = int(np.sum(layout.present[:, :rows] & (self.row_sigma[:, :rows] == 0)))
        angles = int(layout.moving.sum() + np.sum(layout.sensed & (self.angle_sigma > 0)))
        return "\n".join([
            f"calibration of {self.model.machine.name}: {len(self.poses)} poses of {self.poses.name}",
            f"variables θ ({len(self.parameters)})", *listing.variables(self.parameters, self.fixed),
            f"and {angles} angles of the poses [rad, m]",
            "minimise the sum of", *(f"  {term}" for term in self.objective),
            "subject to the bounds and",
            *([f"  loop closure: tip − fixture = 0 [m], {closed} rows"] if closed else ["  nothing else"])])

    def fixing(self, **values: float) -> CalibrationProblem:
        """The problem with parameters held, ``fixing(**{"ball.y": 0.0})`` [SI].

        Raises:
            ProblemError: there is no such parameter, or its value is not finite.
        """
        for name, value in values.items():
            self.parameters.index(name)
            if not np.isfinite(value):
                raise ProblemError(f"it cannot be held at {value}", where=f"parameter '{name}'",
                                   remedy="give a finite number")
        return replace(self, fixed={**self.fixed, **values})

    def with_loss(self, loss: PoseLoss) -> CalibrationProblem:
        """The problem with another loss."""
        return replace(self, loss=loss)

    def without(self, rows: NDArray[np.bool_]) -> CalibrationProblem:
        """The problem without some of its poses (N,); parameters stay."""
        keep = ~np.asarray(rows, dtype=bool)
        old = self.layout
        n = old.reading.shape[1]
        where, which, factor = old.locked
        taken = keep[where // n]
        new_row = np.cumsum(keep) - 1
        locked = (new_row[where[taken] // n] * n + where[taken] % n, which[taken], factor[taken])
        layout = PoseLayout(old.reading[keep], old.sensed[keep], old.moving[keep], locked,
                            old.place[keep], old.given[keep], old.held[keep], old.target[keep], old.present[keep])
        return replace(self, poses=self.poses.select(keep), layout=layout, row_sigma=self.row_sigma[keep])


def calibration_problem(machine: GivenMachine, poses: Poses, validation: Poses | None = None, *,
                        fixed: Mapping[str, float] | None = None, priors: bool = True) -> CalibrationProblem:
    """The kinematic calibration of a machine from a table of poses.

    Args:
        machine: numbers of its geometry that state a confidence are calibrated, the others are exact.
        poses: measured ones, stages in the order in which they were measured.
        validation: poses that are predicted, not fitted.
        fixed: values [SI] of parameters that are held.
        priors: whether the file's confidences count as measurements, or only say what is unknown.

    Raises:
        ProblemError: poses and machine do not fit together; the sentence names the row.

    >>> import hydroopt
    >>> machine = hydroopt.load_machine("panda_mukca")
    >>> plan = hydroopt.solve(hydroopt.pose_problem(machine, 20), candidates=50)
    >>> hydroopt.calibration_problem(machine, plan.postures, fixed={"tip.x": 0.0})
    <CalibrationProblem of panda_mukca: 35 parameters from 40 poses>
    """
    machine = machine_of(machine, "calibration_problem")
    all_of([poses] if validation is None else [poses, validation], (Poses,), "table of poses", "calibration")
    for each in [poses] if validation is None else [poses, validation]:
        _refuse_unfilled(machine, each)
    model = recent_chain(machine)
    builder = LayoutBuilder(machine, model, poses)
    if not len(builder.parameter_set()):
        raise ProblemError("no number of its geometry states how far it may be off: there is nothing to calibrate",
                           where=f"machine '{machine.name}'",
                           remedy="state a 'sigma' of pins and lengths in the machine file")
    problem = CalibrationProblem(
        model, poses, validation, builder.parameter_set(), builder.layout(), builder.angle_sigma(),
        builder.row_sigma(), builder.distances(), builder.exact() | dict(fixed or {}), priors)
    return placed(problem.fixing(**problem.fixed))


def _refuse_unfilled(machine: Machine, poses: Poses) -> None:
    """Refuse a table without a reading; zeros where a datum is touched are part of the plan."""
    datums = {datum.name for datum in machine.datums}
    if not any(np.any(np.isfinite(values)) for name, values in poses.channels.items()
               if name.partition(".")[0] not in datums):
        raise ProblemError("no reading is filled in", where=next(iter(poses.sha256), poses.name), remedy=UNFILLED)
