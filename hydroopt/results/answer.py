"""What `solve` returns, whatever the job: an answer with status, diagnostics, parameters, and a folder it fits into."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from hydroopt.errors import ProblemError
from hydroopt.notebook_card import Card, CardTable, Drawn
from hydroopt.results import json_file
from hydroopt.results.command_line import CommandLine
from hydroopt.results.diagnostic import Diagnostic, of_kind
from hydroopt.results.fit import Fit
from hydroopt.results.json_file import MachineId
from hydroopt.results.parameter_table import ParameterRow, ParameterTable
from hydroopt.results.readable import readable
from hydroopt.results.status import Status
from hydroopt.results.tables import number
from hydroopt.results.verdict import Action, NextStep, Use, Verdict
from hydroopt.results.wording import CONTRADICTIONS, REFUTATIONS, UNSTATED

if TYPE_CHECKING:
    import pandas as pd


class Answer(Drawn, ABC):
    """The answer of any job; `hydroopt.load` reads what `save` wrote.

    It has a status, diagnostics, a table of parameters, a fit and files; the class of each job adds its own results.

    >>> import hydroopt
    >>> model = hydroopt.Model(hydroopt.load_machine("patu655_lift"))
    >>> log = hydroopt.simulate(model, hydroopt.random_trajectory(model, duration=10, rate=20, seed=1))
    >>> answer = hydroopt.solve(hydroopt.identification_problem(model, [log]), "wls")
    >>> isinstance(answer, hydroopt.Answer), answer.machine_name
    (True, 'patu655_lift')
    >>> friction = answer["lift_cylinder.f_coulomb"]
    >>> friction.unit, friction.std < friction.value < friction.ci95[1]
    ('N', True)
    >>> answer.fit_to_frame().index.names, sorted(answer.files())[:2]
    (FrozenList(['data', 'channel']), ['base_parameters.csv', 'fit.csv'])
    >>> answer.details()["active_constraints"], answer.content()["method"]
    ([], 'wls')
    >>> answer.save("crane")
    >>> hydroopt.load("crane").parameters["lift_cylinder.f_coulomb"].unit
    'N'
    """

    job: json_file.Job
    """Which job it answers."""
    command_line: ClassVar[CommandLine] = CommandLine()
    """What was typed to get it, see `typed`; it is not part of the answer."""

    def typed(self, command_line: CommandLine) -> Self:
        """The same answer, whose next steps continue what was typed."""
        made = copy.copy(self)
        made.__dict__["command_line"] = command_line
        return made

    @property
    @abstractmethod
    def machine_id(self) -> MachineId:
        """Which machine it is about, as it was described to the job."""

    @property
    def machine_name(self) -> str:
        """Name of that machine."""
        return self.machine_id.name

    @property
    @abstractmethod
    def method(self) -> str:
        """How it was computed."""

    @property
    def status(self) -> Status:
        """Whether it can be believed: suspect where a diagnostic contradicts it."""
        return Status.SUSPECT if self.contradictions else Status.OK

    @property
    def contradictions(self) -> tuple[Diagnostic, ...]:
        """The diagnostics that make it suspect."""
        return of_kind(self.diagnostics, *CONTRADICTIONS)

    @property
    def refuted(self) -> bool:
        """Whether the data contradict the machine file as they are read, so that commands end with exit code 3."""
        return bool(of_kind(self.diagnostics, *REFUTATIONS))

    @property
    @abstractmethod
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics, the most severe first."""

    @property
    def verdict(self) -> Verdict:
        """What it can be used for, what not, and what to do next."""
        against = self.contradictions
        first = (*of_kind(against, *REFUTATIONS), *of_kind(self.diagnostics, *UNSTATED), *against)
        checks = (NextStep(Action.CHECK, remedy) for remedy in dict.fromkeys(each.remedy for each in first) if remedy)
        return Verdict(json_file.title(self.machine_name, self.job, self.method), self.status,
                       first[0].text if first else "", self.uses, (*checks, *self.next_steps), self.headline)

    @property
    def headline(self) -> str:
        """The answer in a sentence, where the job asks a question; empty elsewhere."""
        return ""

    @property
    @abstractmethod
    def uses(self) -> tuple[Use, ...]:
        """What it can be used for, by the figures alone."""

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What to do next, the most useful first, beside removing what contradicts it."""
        return ()

    @property
    def using_machine(self) -> tuple[str, str]:
        """What to do with the calibrated machine file that is saved, and a command that does it."""
        return ("Use the calibrated machine file in all other commands, such as:",
                f"hydroopt show {self.command_line.path(f'{self.machine_name}.toml')}")

    @property
    def findings(self) -> tuple[Diagnostic, ...]:
        """The answer in sentences, where it has one: what changed, or which payload is carried."""
        return ()

    @property
    def parameters(self) -> ParameterTable:
        """The parameters by name, with priors, values, intervals and identifiability; none where nothing is identified.
        """
        return ParameterTable([])

    @property
    def fit(self) -> Mapping[str, Mapping[str, Fit]]:
        """How closely data are followed, by data set (``train``, ``validation``) and channel; empty where nothing is
        fitted."""
        return {}

    @property
    def fit_by_model(self) -> Mapping[str, Mapping[str, Mapping[str, Fit]]]:
        """The same by name of several models that stand side by side; empty where there is one alone."""
        return {}

    @property
    @abstractmethod
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The files it is from: path, sha256, samples, role."""

    @abstractmethod
    def details(self) -> Mapping[str, Any]:
        """What the JSON file says beyond what all answers say; numbers that do not exist are None."""

    def files(self) -> Mapping[str, str | bytes]:
        """Files beside the JSON file, by name: tables, and the calibrated machine where there is one."""
        return {}

    def text_of(self, name: str) -> str | None:
        """The content of one of `files` that is a text; None where there is none of this name."""
        text = self.files().get(name)
        return text if isinstance(text, str) else None

    def __getitem__(self, name: str) -> ParameterRow:
        """A parameter: value, standard deviation, interval, unit and identifiability, in SI.

        Raises:
            ProblemError: there is no such parameter; the closest names are given.
        """
        return self.parameters[name]

    def __repr__(self) -> str:
        return (f"<{self.job} of {self.machine_name} by {self.method}: {self.status}, "
                f"{len(self.parameters)} parameters, {len(self.diagnostics)} diagnostics>")

    def __str__(self) -> str:
        lines = [f"{self.machine_name} by {self.method}: {self.status}"]
        if self.fit_by_model:
            lines.append(f"  {'RMS error and VAF by model':<42}" + "".join(f"{name:>22}" for name in self.fit_by_model))
        for data, table in self.fit.items():
            for channel, fit in table.items():
                beside = "".join(f"{one.rms:10.4g} {_percent(one.vaf)}" for one in (
                    sets[data][channel] for sets in self.fit_by_model.values()))
                lines.append(f"  {data:<10} {channel:<24} " + (f"{fit.unit:<5}{beside}" if beside else str(fit)))
        return "\n".join([*lines, *(f"  {finding.text}" for finding in self.findings)])

    def card(self) -> Card:
        """What a notebook shows: the verdict, the fit, the parameters, findings and diagnostics."""
        found = " ".join(each.text for each in self.findings)
        facts = self.verdict.facts | ({"found": found} if found else {})
        fits = [(data, channel, readable(fit.rms, fit.unit, 3), _percent(fit.vaf).strip())
                for data, table in self.fit.items() for channel, fit in table.items()]
        diagnostics = [(str(each.kind), each.text) for each in self.diagnostics]
        return Card(f"{self.verdict.title}: {self.status}", facts, [table for table in (
            CardTable(("data", "channel", "RMS error", "VAF"), fits, noun="channels"), *self.parameters.card_tables(),
            CardTable(("diagnostic", ""), diagnostics, shown=3, noun="diagnostics")) if table.rows])

    def to_frame(self) -> pd.DataFrame:
        """The table of parameters as a pandas DataFrame indexed by name."""
        return self.parameters.to_frame()

    def fit_to_frame(self) -> pd.DataFrame:
        """The fit as a pandas DataFrame indexed by data set and channel."""
        import pandas as pd  # noqa: PLC0415 (import cost)

        rows = [{"data": data, "channel": channel, **fit.as_dict()}
                for data, table in self.fit.items() for channel, fit in table.items()]
        return pd.DataFrame(rows, columns=None if rows else ["data", "channel"]).set_index(["data", "channel"])

    def save(self, directory: str | Path, *, pages: Mapping[str, str | bytes | None] | None = None,
             wall_s: float = float("nan")) -> None:
        """Write everything that the answer knows into a directory, whole or not at all; an earlier answer there goes.

        Args:
            directory: created if need be.
            pages: further files by name, such as the report (`hydroopt.report`); None removes one.
            wall_s: how long the job took [s].

        Raises:
            ProblemError: the directory cannot be written.
        """
        json_file.write(directory, self.job, self.content(wall_s=wall_s), {**self.files(), **(pages or {})})

    def content(self, *, wall_s: float = float("nan")) -> dict[str, Any]:
        """The content of the JSON file."""
        return json_file.header(self.job, self.machine_id, self.method, self.inputs) | {
            "status": str(self.status), "verdict": self.verdict.as_dict(),
            "findings": [each.as_dict() for each in self.findings],
            "diagnostics": [each.as_dict() for each in self.diagnostics],
            "parameters": [each.as_dict() for each in self.parameters.rows],
            "fit": {data: {channel: fit.as_dict() for channel, fit in table.items()}
                    for data, table in self.fit.items()},
            **self.details(), "wall_s": number(wall_s)}


class SavedAnswer(Answer):
    """An answer that was loaded: what its folder says.

    Attributes:
        directory: where it is from.
        saved: the whole content of its JSON file.
    """

    def __init__(self, directory: Path, saved: Mapping[str, Any]) -> None:
        self.directory, self.saved, self.job = directory, saved, json_file.Job(saved["job"])
        self._status, self._method = Status(saved["status"]), str(saved["method"])
        self._verdict = Verdict.from_dict(saved["verdict"]) if "verdict" in saved else None
        self._inputs = tuple(dict(entry) for entry in saved["inputs"])
        self._diagnostics = tuple(Diagnostic.from_dict(entry) for entry in saved.get("diagnostics", ()))
        self._findings = tuple(Diagnostic.from_dict(entry) for entry in saved.get("findings", ()))
        self._parameters = ParameterTable.from_dicts(saved.get("parameters", ()))
        self._fit = {data: {channel: Fit.from_dict(entry) for channel, entry in table.items()}
                     for data, table in saved.get("fit", {}).items()}
        self._fit_by_model = {name: {data: {channel: Fit.from_dict(entry) for channel, entry in table.items()}
                                     for data, table in sets.items()}
                              for name, sets in saved.get("fit_by_model", {}).items()}

    @property
    def machine_id(self) -> MachineId:
        """Which machine it is about."""
        return MachineId(**{key: str(self.saved["machine"][key]) for key in MachineId._fields})

    @property
    def method(self) -> str:
        """How it was computed."""
        return self._method

    @property
    def status(self) -> Status:
        """Whether it can be believed."""
        return self._status

    @property
    def reason(self) -> str:
        """Why it failed; empty if it did not."""
        return str(self.saved.get("reason", ""))

    @property
    def verdict(self) -> Verdict:
        """What it can be used for, what not, and what to do next."""
        named = json_file.title(self.machine_name, self.job, self.method)
        return self._verdict or Verdict(named, self.status, self.reason)

    @property
    def uses(self) -> tuple[Use, ...]:
        """What it can be used for."""
        return self.verdict.uses

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics, the most severe first."""
        return self._diagnostics

    @property
    def findings(self) -> tuple[Diagnostic, ...]:
        """The answer in sentences, where it has one."""
        return self._findings

    @property
    def parameters(self) -> ParameterTable:
        """The parameters by name, with priors, values, intervals and identifiability."""
        return self._parameters

    @property
    def fit(self) -> Mapping[str, Mapping[str, Fit]]:
        """How closely data are followed, by data set and channel."""
        return self._fit

    @property
    def fit_by_model(self) -> Mapping[str, Mapping[str, Mapping[str, Fit]]]:
        """How closely several models follow data."""
        return self._fit_by_model

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The files it is from."""
        return self._inputs

    @property
    def machine_file(self) -> Path | None:
        """The calibrated machine beside it; None where none was written.

        Raises:
            ProblemError: it is not as it was saved.
        """
        name = f"{self.machine_name}.toml"
        return None if self.files().get(name) is None else self.directory / name

    def details(self) -> Mapping[str, Any]:
        """What the JSON file says beyond what all answers say."""
        return {key: value for key, value in self.saved.items() if key not in json_file.COMMON}

    def files(self) -> Mapping[str, str | bytes]:
        """The files beside the JSON file."""
        return json_file.Beside(self.directory, self.saved)


def load(directory: str | Path) -> SavedAnswer:
    """The answer that a command or `Answer.save` wrote into a directory.

    Args:
        directory: such as ``out/crane``, with ``estimate.json`` or the JSON file of another job; or that file. Machines
            are read by `load_machine`, logs by `read_log`.

    Raises:
        ProblemError: there is no answer, or it is damaged or of another version.

    >>> load("out")
    Traceback (most recent call last):
    ...
    hydroopt.errors.ProblemError: out: this folder holds no estimate; name the folder that a hydroopt command wrote.

    See `Answer` for one that is there.
    """
    folder = Path(directory)
    if folder.is_file():
        if folder.name not in json_file.FILES.values():
            raise ProblemError("this file is no answer of hydroopt", where=str(folder),
                               remedy="name the folder that a command wrote; read a machine by load_machine, a log by "
                                      "read_log")
        folder = folder.parent
    content = json_file.read(folder)
    try:
        return SavedAnswer(folder, content)
    except (LookupError, ValueError, TypeError, AttributeError, ArithmeticError):
        raise json_file.not_an_answer(folder) from None


def _percent(part: float) -> str:
    """A part of one in per cent; a dash for NaN, as of what nothing measures."""
    return f"{100 * part:9.2f} %" if math.isfinite(part) else f"{'–':>9}  "
