"""What can go wrong, each in one sentence: what it is, where it is, and what to do about it."""


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
    """A machine description is incomplete, contradictory or geometrically impossible."""


class LogError(HydrooptError):
    """A measurement file is damaged, lacks a channel or states an impossible value."""


class ProblemError(HydrooptError):
    """A problem, option or constraint was stated in a way that cannot be solved as asked."""


class IdentifiabilityError(HydrooptError):
    """The data cannot answer the question: nothing would be left to estimate."""


class SolverError(HydrooptError):
    """A solver gave no trustworthy answer (infeasible, not converged, or its answer failed our check)."""

    exit_code = 3


class StoppedError(HydrooptError):
    """Ctrl-C ended what can go on later from where it was."""

    exit_code = 130
