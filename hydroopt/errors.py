"""The errors of hydroopt: each message is one sentence that states what is wrong, where, and what to do."""


class HydrooptError(Exception):
    """Base of all errors that a user can cause and correct; `exit_code` is what the command line returns.

    The sentence reads "<where>: <what>; <remedy>.". `where` names the file, key, channel, sample or body.

    >>> print(LogError("there is no channel 'boom.q'", where="run.csv", remedy="add a column 'boom.q [deg]'"))
    run.csv: there is no channel 'boom.q'; add a column 'boom.q [deg]'.
    """

    exit_code = 2

    def __init__(self, what: str, *, where: str, remedy: str) -> None:
        self.what, self.where, self.remedy = what, where, remedy
        super().__init__(f"{where}: {what}; {remedy}.")


class MachineError(HydrooptError):
    """A machine description is incomplete, contradictory or geometrically impossible.

    >>> import hydroopt
    >>> hydroopt.read_machine("colour = 'yellow'")
    Traceback (most recent call last):
    ...
    hydroopt.errors.MachineError: machine: colour: this key is unknown; correct its spelling or remove it.
    """


class LogError(HydrooptError):
    """A measurement file is damaged, lacks a channel or states an impossible value.

    >>> import hydroopt
    >>> hydroopt.read_log("missing.csv")
    Traceback (most recent call last):
    ...
    hydroopt.errors.LogError: missing.csv: there is no such file; check the path.
    """


class ProblemError(HydrooptError):
    """A problem, an option or a constraint cannot be used as stated.

    >>> import hydroopt
    >>> hydroopt.solve("no problem")
    Traceback (most recent call last):
    ...
    hydroopt.errors.ProblemError: solve: a str cannot be solved; give one of IdentificationProblem, ...
    """


class IdentifiabilityError(HydrooptError):
    """The data do not identify what is to be estimated.

    >>> import hydroopt
    >>> from dataclasses import replace
    >>> model = hydroopt.Model(hydroopt.load_machine("patu655_lift"))
    >>> motion = hydroopt.random_trajectory(model, duration=5, rate=20, seed=1)
    >>> standstill = replace(motion, q=0 * motion.q, qd=0 * motion.q, qdd=0 * motion.q)
    >>> log = hydroopt.simulate(model, standstill, seed=1)
    >>> hydroopt.solve(hydroopt.identification_problem(model, [log]))
    Traceback (most recent call last):
    ...
    hydroopt.errors.IdentifiabilityError: ...: no joint moves in the training logs; ...
    """


class SolverError(HydrooptError):
    """A solver gave no trustworthy answer: infeasible, not converged, or its answer failed the check.

    The command line returns 3 and marks the result as failed.

    >>> SolverError("IPOPT failed: it ran out of iterations", where="calibration of crane",
    ...             remedy="start from a better nominal model").exit_code
    3
    """

    exit_code = 3


class StoppedError(HydrooptError):
    """Ctrl-C ended what can go on later from where it was."""

    exit_code = 130
