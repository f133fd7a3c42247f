"""An identification problem that a user can read and extend; solving it never changes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.force_problem import LOSSES, ForceProblem, Loss
from hydroopt.estimation.dynamic.instruments import instrument
from hydroopt.estimation.dynamic.training_logs import prepared, refuse_added, refuse_repetition
from hydroopt.estimation.dynamic.weighted_residuals import weighted_residuals
from hydroopt.estimation.inference import convex_program, listing, nlp
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.inference.listing import counted
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.estimation.inference.whitening import gaussian_posterior
from hydroopt.logs.calibrator_angles import calibrator_channels
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.logs.frames import all_of
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model.model import Model, recent_model
from hydroopt.spatial.inertia import Array
from hydroopt.support.notebook_card import Shown


@dataclass(frozen=True, eq=False)
class IdentificationProblem(ForceProblem, Shown):
    """Weighted residuals f − K·ψ of some experiments, priors and constraints on ψ: an optimisation model.

    `identification_problem` makes one; each method returns a new one. It prints as variables, objective and
    constraints; `nlp` and `cvxpy` export it to other tools.

    >>> import hydroopt as ho
    >>> log = ho.simulate("cat215b", ho.random_trajectory("cat215b", duration=5.0, rate=20.0, seed=1))
    >>> problem = identification_problem("cat215b", log)
    >>> problem = problem.with_total_mass("scales", ["boom", "stick"], 2500.0, sigma=20.0).fix("swing.m")
    >>> print(str(problem).split("subject to")[0].splitlines()[-1].strip())
    prior scales: boom.m + stick.m = 2500 ± 20 kg
    >>> problem = problem.with_prior("boom", "boom.m = 1800 +- 50 kg").with_loss("huber").symmetric("boom", "xy")
    >>> problem.identical("rods", ["boom_cylinder.rod", "stick_cylinder.rod"]).stated_constraints[-4:]
    ('rods', 'scales', 'boom', 'swing.m fixed')
    >>> problem.with_distance("log-det").distance, problem.free("delay").freed, problem.by_data_alone().data_alone
    ('log-det', ('delay',), True)
    >>> problem.with_fitted_motion().fitted_motion, problem.with_correlated_channels().correlated
    (True, True)
    >>> len(problem.with_instruments([log]).instruments), problem.nlp().p_names[0], problem.cvxpy()
    (1, 'swing_motor.sigma', ConvexProgram(82 parameters, 16 constraints))
    """

    def free(self, *faults: str) -> IdentificationProblem:
        """With faults of instruments estimated together with the parameters, their uncertainty in all intervals.

        Args:
            faults: groups such as ``delay`` (of all forces), ``lag``, ``clock``, ``tilt``, ``gain``, ``offset``,
                ``drift``, ``friction``, a group with its subject such as ``delay boom.q``, or ``instruments`` for
                gains, offsets, tilt and delay within what good instruments err.

        Raises:
            ProblemError: motion is fitted or has instruments, or channels correlate.
        """
        if self.fitted_motion or self.instruments or self.correlated:
            raise ProblemError("freed faults cannot be combined with a fitted motion, instruments or correlated "
                               "channels", where="faults", remedy="choose one of them")
        return replace(self, freed=(*self.freed, *faults))

    def with_loss(self, loss: Loss) -> IdentificationProblem:
        """With another loss: ``squares``, ``huber`` or ``student_t``."""
        if loss not in ("squares", "huber", "student_t"):
            raise ProblemError(f"'{loss}' is not a loss", where="loss", remedy="use squares, huber or student_t")
        return replace(self, loss=loss)

    def with_correlated_channels(self) -> IdentificationProblem:
        """With the covariance of the actuators' residuals estimated and used, instead of a weight for each.

        Raises:
            ProblemError: instruments were given.
        """
        if self.instruments:
            raise ProblemError("correlated channels cannot be combined with instruments", where="channels",
                               remedy="choose one of the two")
        return replace(self, correlated=True)

    def with_fitted_motion(self) -> IdentificationProblem:
        """With motion and parameters fitted together by maximum a posteriori.

        Angles have the accuracy that the machine file states; the training data's motion, not that of the validation
        data, is then what angles and forces together make most probable.

        Raises:
            ProblemError: instruments were given, or the calibrator is attached in a log.
        """
        refuse_added("a fitted motion", self.experiments)
        if self.instruments:
            raise ProblemError("a fitted motion cannot be combined with instruments", where="motion",
                               remedy="choose one of the two")
        return replace(self, fitted_motion=True)

    def with_instruments(self, logs: Sequence[Log] = ()) -> IdentificationProblem:
        """With instrumental variables from a second reading of the same motion.

        Args:
            logs: one for each training log, with channels ``<joint>.q`` (and ``.qd``, ``.qdd``, if known)
                that cover its time: the reference that was driven, or a repetition of the motion. Without logs the
                lengths of cylinders serve, which must stand beside the angles of all joints.

        Raises:
            ProblemError: another number of logs, a fitted or correlated problem, a joint without a second reading, or
                the calibrator is attached in a log.
            LogError: a reference does not cover its log, or lacks a joint.
        """
        refuse_added("instruments", self.experiments)
        if self.fitted_motion or self.correlated:
            raise ProblemError("instruments cannot be combined with a fitted motion or correlated channels",
                               where="motion", remedy="choose one of them")
        if logs and len(logs) != len(self.experiments):
            raise ProblemError(f"{len(logs)} instruments are given for {len(self.experiments)} logs",
                               where="instruments", remedy="give one for each training log")
        return replace(self, instruments=tuple(instrument(self.model, data, logs[k] if logs else None)
                                               for k, data in enumerate(self.experiments)))

    def nlp(self, point: Array | None = None) -> NonlinearProgram:
        """The problem as CasADi's nonlinear program; ``solve(problem, "nlp", intervals=False)`` has the same optimum.

        Variables are the parameters ψ in SI, then Cholesky factors of the matrices that must be positive semidefinite.
        The residuals have the weights that the solver ends with; the standard deviations in these weights are the
        program's fixed numbers p.

        Args:
            point: (p,) parameters at which forces are linearised that are not linear in them: an estimate's, which is
                then the optimum; the nominal ones by default.

        Raises:
            ProblemError: a constraint does not return a relation.
            IdentifiabilityError: no joint moves.
            SolverError: a fitted motion does not converge.
        """
        weighted = weighted_residuals(
            self, RANK_TOLERANCE, lambda R, r: nlp.interior_point(self, gaussian_posterior(self, R, r)).psi, point)
        return nlp.nonlinear_program(self, weighted.terms)

    def cvxpy(self, point: Array | None = None) -> convex_program.ConvexProgram:
        """The problem as cvxpy's convex program; ``solve(problem, "sdp", intervals=False)`` has the same optimum.

        Args:
            point: as of `nlp`.

        Raises:
            ProblemError: a constraint is not convex, or constraints contradict each other.
            IdentifiabilityError, SolverError: as of `nlp`.
        """
        def optimum(R: Array, r: Array) -> Array:
            posterior = gaussian_posterior(self, R, r)
            return convex_program.semidefinite_program(self, posterior, consistent=self.consistent).psi

        weighted = weighted_residuals(self, RANK_TOLERANCE, optimum, point)
        return convex_program.convex_program(self, weighted.R, weighted.r, weighted.rest)

    def __repr__(self) -> str:
        return (f"{type(self).__name__}({self.model.machine.name}: {len(self.parameters)} parameters, "
                f"{counted(len(self.experiments), 'training log')}, loss {self.loss}, "
                f"{counted(len(self.constraint_names), 'constraint')})")

    def __str__(self) -> str:
        parameters, machine = self.parameters, self.model.machine
        samples = sum(e.sample_count for e in self.experiments)
        lines = [f"{self.where}: {samples} samples in {counted(len(self.experiments), 'training log')}",
                 f"variables ψ ({len(parameters)})", *listing.variables(parameters, self.fixed), "minimise the sum of"]
        for balance, std in zip(machine.balances, self.force_std, strict=True):
            weight = f"σ = {listing.number(std)} {balance.unit}" if np.isfinite(std) else "σ unknown"
            lines.append(f"  residuals of {balance.name}: {LOSSES[self.loss]}, e = f − K·ψ [{balance.unit}], "
                         f"{weight}, re-estimated from the residuals")
        lines += ["  residuals of the actuators correlate: their covariance weights them"] * self.correlated
        lines += ["  motion fitted together with the parameters: (q_measured − q)²/σ²"] * self.fitted_motion
        lines += ["  instrumental variables from a second reading of the motion"] * bool(self.instruments)
        known = int(np.sum(np.diag(parameters.information) > 0))
        lines.append(f"  priors of the machine file: (ψ − nominal)ᵀ·Λ·(ψ − nominal) over {known} parameters")
        lines += ["  log-det distance of every body from its nominal one"] * (self.distance == "log-det")
        lines += [f"  {listing.prior(parameters, one)}" for one in (*self.stated_priors, *self.priors)]
        conditions = self.statements(consistent=self.consistent)
        return "\n".join([*lines, "subject to the bounds and", *listing.constraints(
            parameters, conditions, self.constraints)])


def identification_problem(machine: GivenMachine | Model, logs: Log | Sequence[Log],
                           validation: Log | Sequence[Log] = (), *,
                           smoothing: Smoothing | None = None, actuator_inertia: bool = True) -> IdentificationProblem:
    """The dynamic identification problem of a machine and its logs.

    Args:
        machine: nominal description, with its confidences; or its model, which need not be built again then.
        logs: training data.
        validation: logs for validation only.
        smoothing: how angles are differentiated; a smoothing spline by default.
        actuator_inertia: whether barrels and rods belong to the model that is built. The calibrator's bodies do if a
            log has angles of its joints.

    Raises:
        LogError: a channel is missing or a log is too short.
        ProblemError: there is no log, or one is given twice.

    >>> import hydroopt as ho
    >>> log = ho.simulate("cat215b", ho.random_trajectory("cat215b", duration=5.0, rate=20.0, seed=1))
    >>> identification_problem("cat215b", log).subject_to("arm", "boom.m + stick.m <= 2600 kg").stated_constraints
    ('arm',)
    """
    logs, validation = (all_of(some, (Log,), "log", "identification") for some in (logs, validation))
    machine = machine if isinstance(machine, Model) else machine_of(machine, "identification_problem")
    refuse_repetition([*logs, *validation])
    if not logs:
        raise ProblemError("there is no training log", where="identification", remedy="give at least one")
    model = machine if isinstance(machine, Model) else recent_model(
        machine, actuator_inertia=actuator_inertia, calibrator=any(
            calibrator_channels(machine, log) for log in (*logs, *validation)))
    train, held_out = ([prepared(log, model, smoothing) for log in some] for some in (logs, validation))
    return IdentificationProblem(model, tuple(train), tuple(held_out), force_noise(model, logs[0]))
