"""The problem of estimating geometry, bodies and friction together, from recordings that tell both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.dynamic.training_logs import refuse_added
from hydroopt.estimation.inference.listing import counted
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.machine_file import GivenMachine
from hydroopt.notebook_card import Shown


@dataclass(frozen=True, eq=False)
class CombinedProblem(Shown):
    """Geometry, bodies and friction, to be estimated together from the same logs.

    Attributes:
        identification: the problem of bodies and friction, with all that is stated of them.
        smoothing: how angles are differentiated for the initial guess, and for validation.

    See `combined_problem`.
    """

    identification: IdentificationProblem
    smoothing: Smoothing | None = None

    def __post_init__(self) -> None:
        problem = self.identification
        refuse_added("geometry", problem.experiments)
        taken = {"instruments": bool(problem.instruments), "correlated channels": problem.correlated,
                 "freed faults": bool(problem.freed), f"the loss '{problem.loss}'": problem.loss != "squares",
                 "fitted rates and accelerations": any(data.position_std is not None
                                                       for data in problem.experiments)}
        if named := [what for what, so in taken.items() if so]:
            raise ProblemError(f"geometry cannot be estimated together with {named[0]}", where="geometry",
                               remedy="choose one of the two")

    def __repr__(self) -> str:
        problem = self.identification
        return (f"CombinedProblem({problem.model.machine.name}: geometry and {len(problem.parameters)} parameters, "
                f"{counted(len(problem.experiments), 'training log')})")


def combined_problem(machine: GivenMachine, logs: Log | Sequence[Log], validation: Log | Sequence[Log] = (),
                     *, smoothing: Smoothing | None = None) -> CombinedProblem:
    """The problem of geometry, bodies and friction together.

    Args:
        machine: nominal description; numbers of its geometry with a stated `sigma` are unknown, within that.
        logs: training data with forces or pressures and, besides the joints' angles, readings that depend on the
            geometry: angles of an attached calibrator, lengths of cylinders, places of the tip.
        validation: logs for validation only.
        smoothing: how angles are differentiated for the initial guess; a smoothing spline by default.

    Raises:
        LogError: a channel is missing or a log is too short.
        ProblemError: there is no log, one is read in pieces, or the calibrator's bodies load the machine.

    >>> import hydroopt as ho
    >>> log = ho.simulate("cat215b", ho.random_trajectory("cat215b", duration=5.0, rate=20.0, seed=1))
    >>> ho.combined_problem("cat215b", log)
    CombinedProblem(cat215b: geometry and 82 parameters, 1 training log)
    """
    return CombinedProblem(identification_problem(machine, logs, validation, smoothing=smoothing), smoothing)
