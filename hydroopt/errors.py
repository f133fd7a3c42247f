"""The errors of hydroopt: each message is one sentence that states what is wrong, where, and what to do."""

LONGEST = 299
"""Characters of the longest sentence; what is quoted in it is shortened."""
_LONGEST_WORD = 48
_LEAST = (("what", 110), ("where", 80), ("remedy", 100))
"""To how many characters the parts of a sentence may be shortened, in the order in which they are."""


class HydrooptError(Exception):
    """Base of all errors that a user can cause and correct; `exit_code` is what the command line returns.

    The sentence reads "<where>: <what>; <remedy>.". `where` names the file, key, channel, sample or body. It has at
    most `LONGEST` characters and none that changes how a terminal shows it, whatever names of the data it quotes.

    >>> print(LogError("there is no channel 'boom.q'", where="run.csv", remedy="add a column 'boom.q [deg]'"))
    run.csv: there is no channel 'boom.q'; add a column 'boom.q [deg]'.
    """

    exit_code = 2

    def __init__(self, what: str, *, where: str, remedy: str) -> None:
        parts = {"what": what, "where": where, "remedy": remedy}
        room = LONGEST - len(": ; .")
        if sum(map(len, parts.values())) > room:
            parts = {name: " ".join(shortened(word, _LONGEST_WORD) for word in part.split(" "))
                     for name, part in parts.items()}
        parts = {name: visible(part) for name, part in parts.items()}
        for name, least in _LEAST:
            excess = sum(map(len, parts.values())) - room
            if excess > 0:
                parts[name] = shortened(parts[name], max(least, len(parts[name]) - excess))
        self.what, self.where, self.remedy = parts["what"], parts["where"], parts["remedy"]
        super().__init__(f"{self.where}: {self.what}; {self.remedy}.")


class MachineError(HydrooptError):
    """A machine description is incomplete, contradictory or geometrically impossible.

    >>> import hydroopt
    >>> hydroopt.read_machine("colour = 'yellow'")
    Traceback (most recent call last):
    ...
    hydroopt.errors.MachineError: machine: colour: this key is unknown; use one of name, parameter_set, ...
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
    hydroopt.errors.ProblemError: solve: a str cannot be solved; give one of CombinedProblem, ...
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
    hydroopt.errors.IdentifiabilityError: ...: no joint moves in the training logs, and they hold a single posture; ...
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


def visible(text: str, *, keep: str = "") -> str:
    """The text with escapes for characters that show nothing, move the cursor or reverse the direction of writing.

    Args:
        text: may quote anything.
        keep: characters of these that stay, such as line ends.

    >>> visible("pump\\x1b[2J")
    'pump\\\\x1b[2J'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep or c == "\N{NO-BREAK SPACE}" else ascii(c)[1:-1] for c in text)


def shortened(text: str, most: int) -> str:
    """The text, without its middle where it has more than `most` characters.

    >>> shortened("a path that is much too long/run.csv", 20)
    'a path th…ng/run.csv'
    """
    if len(text) <= most:
        return text
    head = (most - 1) // 2
    return f"{text[:head]}…{text[len(text) - (most - 1 - head):]}"
