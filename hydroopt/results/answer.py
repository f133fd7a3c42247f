"""What `solve` returns, whatever the job: an answer with status, diagnostics, parameters, and a folder it fits into."""

from __future__ import annotations

import copy
import math
import shlex
from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, cast

import numpy as np

from hydroopt.errors import HydrooptError, ProblemError
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, load_machine, read_machine
from hydroopt.results import json_file
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.results.fit import Fit
from hydroopt.results.json_file import MachineId, validated
from hydroopt.results.parameter_table import ParameterRow, ParameterTable
from hydroopt.results.readable import readable
from hydroopt.results.status import Status
from hydroopt.results.tables import number
from hydroopt.results.verdict import Action, Claim, NextStep, Verdict
from hydroopt.support.notebook_card import Card, CardTable, Drawn

if TYPE_CHECKING:
    import pandas as pd


KINDS = {
    "Estimate": ("estimation.dynamic.estimate", json_file.Job.IDENTIFICATION, "identification.render"),
    "CombinedEstimate": ("estimation.combined.estimate", json_file.Job.IDENTIFICATION, "identification.render"),
    "Calibration": ("estimation.kinematic.calibration", json_file.Job.CALIBRATION, "calibration.render"),
    "SensorCalibration": ("estimation.motion.sensor_calibration", json_file.Job.SENSORS, "sensors.render"),
    "HydraulicEstimate": ("estimation.hydraulic.estimate", json_file.Job.HYDRAULICS, "valves.render"),
    "Excitation": ("excitation.motion.excitation", json_file.Job.EXCITATION, "excitation.render"),
    "PosePlan": ("excitation.selection.pose_plan", json_file.Job.POSE_PLAN, "pose_plan.render"),
    "MeasureUpPlan": ("excitation.selection.measure_up", json_file.Job.POSE_PLAN, "pose_plan.render"),
    "CalibratorDesign": ("excitation.selection.calibrator_design", json_file.Job.CALIBRATOR, "calibrator.render"),
    "WhatNext": ("excitation.selection.what_next", json_file.Job.NEXT, "what_next.render"),
    "SessionComparison": ("estimation.dynamic.session_comparison", json_file.Job.CHANGE, "sessions.render_comparison"),
    "Payload": ("estimation.dynamic.payload", json_file.Job.PAYLOAD, "sessions.render_payload"),
    "Weighing": ("weighing.weighing", json_file.Job.WEIGHING, "weighing.render"),
    "Comparison": ("control.comparison", json_file.Job.CONTROL, "closed_loop.render"),
    "LogCheck": ("estimation.dynamic.log_check", json_file.Job.CHECK, ""),
    "MotionCheck": ("checks.motion", json_file.Job.MOTION_CHECK, ""),
    "PostureCheck": ("checks.postures", json_file.Job.POSTURE_CHECK, "")}
"""Module and job of the class of each answer, which `load` makes again, and what in the room `report` writes its page.
A JSON file names the class."""


@dataclass(frozen=True)
class CommandLine:
    """What was typed, from which next steps are made that can be copied.

    Attributes:
        words: of the command, without the program's name; empty where no command was typed, as in Python.
        directory: that receives the answer; ``DIR`` where no command says so.

    >>> typed = CommandLine(("identify", "cat215b", "my log.csv", "-o", "out"), "out")
    >>> typed.again("--holdout", "0.3")
    "hydroopt identify cat215b 'my log.csv' -o out --holdout 0.3"
    >>> typed.path("poses.csv"), CommandLine().path(), CommandLine().again("--holdout", "0.3")
    ('out/poses.csv', 'DIR', '')
    """

    words: tuple[str, ...] = ()
    directory: str = "DIR"

    def again(self, *more: str) -> str:
        """The same command with more options; empty where none was typed."""
        return shlex.join(("hydroopt", *self.words, *more)) if self.words else ""

    def given(self, *options: str) -> bool:
        """Whether one of the options was typed."""
        return any(word.partition("=")[0] in options for word in self.words)

    def path(self, *parts: str) -> str:
        """A file of the answer, or its directory, quoted for a shell."""
        return shlex.quote(str(Path(self.directory, *parts)))


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
    directory: ClassVar[Path | None] = None
    """Where it was loaded from; None if it was not."""
    command_line: ClassVar[CommandLine] = CommandLine()
    """What was typed to get it, see `typed`; it is not part of the answer."""

    def typed(self, command_line: CommandLine) -> Self:
        """The same answer, whose next steps continue what was typed."""
        made = copy.copy(self)
        made.__dict__["command_line"] = command_line
        return made

    if TYPE_CHECKING:  # a field of some classes, a property of others
        @property
        def machine(self) -> Machine:
            """The machine that it is about; the calibrated one of an answer that calibrates.

            Raises:
                HydrooptError: no machine can have the numbers of the answer.
            """

    @property
    def machine_id(self) -> MachineId:
        """Which machine it is about, as it was described to the job."""
        return MachineId.of(self.machine)

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
        return tuple(each for each in self.diagnostics if each.contradicts)

    @property
    def refuted(self) -> bool:
        """Whether the data contradict the machine file as they are read, so that commands end with exit code 3."""
        return any(each.meaning is Meaning.REFUTATION for each in self.diagnostics)

    def marked(self, machine: Machine) -> Machine:
        """A machine with numbers of this answer, which says so where the answer is suspect, or the machine was before.
        """
        return machine if self.status is Status.OK else machine.model_copy(update={"suspect": self.verdict.cause})

    @property
    @abstractmethod
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics, the most severe first."""

    @property
    def verdict(self) -> Verdict:
        """What it can be used for, what not, and what to do next."""
        first = [each for meaning in (Meaning.REFUTATION, Meaning.LACK, Meaning.CONTRADICTION)
                 for each in self.diagnostics if each.meaning is meaning]
        checks = (NextStep(Action.CHECK, remedy) for remedy in dict.fromkeys(each.remedy for each in first) if remedy)
        return Verdict(json_file.title(self.machine_name, self.job, self.method), self.status,
                       first[0].text if first else "", self.claims, (*checks, *self.next_steps), self.headline)

    @property
    def headline(self) -> str:
        """The answer in a sentence, where the job asks a question; empty elsewhere."""
        return ""

    @property
    @abstractmethod
    def claims(self) -> tuple[Claim, ...]:
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
        """The content of one of `files` that is a text; None where there is none of this name.

        >>> import hydroopt as ho
        >>> motion = ho.random_trajectory("patu655_lift", duration=10, rate=20, seed=1)
        >>> answer = ho.solve(ho.identification_problem("patu655_lift", ho.simulate("patu655_lift", motion)), "wls")
        >>> answer.text_of("fit.csv").splitlines()[0].split(",")[0]
        'model'
        """
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
        lines = [f"  {data:<10} {channel:<24} {fit}" for data, table in self.fit.items()
                 for channel, fit in table.items()]
        if self.fit_by_model:
            lines = self._fit_of_two_models()
        return "\n".join([f"{self.machine_name} by {self.method}: {self.status}", *lines,
                          *(f"  {finding.text}" for finding in self.findings)])

    def _fit_of_two_models(self) -> list[str]:
        """A line a channel: RMS error of the first and of the last model with its VAF, data sets side by side."""
        names = dict.fromkeys((next(iter(self.fit_by_model)), [*self.fit_by_model][-1]))
        lines = [f"  {'RMS error, VAF':<23}" + "".join(f"{data}: {', '.join(names)}".rjust(28) for data in self.fit)]
        units = {channel: one.unit for table in self.fit.values() for channel, one in table.items()}
        for channel, unit in units.items():
            line = f"  {channel:<18} {unit:<4}"
            for data, table in self.fit.items():
                rms = "".join(f"{self.fit_by_model[name][data][channel].rms:9.4g}" for name in names
                              if channel in table)
                line += f"{rms}{_percent(table[channel].vaf)}".rjust(28) if rms else 28 * " "
            lines.append(line.rstrip())
        return lines

    def card(self) -> Card:
        """What a notebook shows: the verdict, the fit, the parameters, findings and diagnostics."""
        found = " ".join(each.text for each in self.findings)
        facts = self.verdict.facts | ({"found": found} if found else {})
        fits = [(data, channel, readable(fit.rms, fit.unit, 3), _percent(fit.vaf).strip())
                for data, table in self.fit.items() for channel, fit in table.items()]
        diagnostics = [(each.kind, each.text) for each in self.diagnostics]
        return Card(f"{self.verdict.title}: {self.status}", facts, [table for table in (
            CardTable(("data", "channel", "RMS error", "VAF"), fits), *self.parameters.card_tables(),
            CardTable(("diagnostic", ""), diagnostics)) if table.rows])

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
            "claims": [each.as_dict() for each in self.verdict.claims if each.bound is not None],
            "findings": [each.as_dict() for each in self.findings],
            "diagnostics": [each.as_dict() for each in self.diagnostics],
            "parameters": [each.as_dict() for each in self.parameters.rows],
            "fit": {data: {channel: fit.as_dict() for channel, fit in table.items()}
                    for data, table in self.fit.items()},
            **self.details(), "wall_s": number(wall_s),
            "answer": {"class": type(self).__name__, "text": str(self), "fields": _fields(self), **self._machine()}}

    def _machine(self) -> dict[str, str]:
        """The text of its machine, where it has one that is no file of its own."""
        if f"{self.machine_name}.toml" not in self.files():
            with suppress(HydrooptError):  # which a diagnostic states
                return {"machine": dump_machine(self.machine)}
        return {}


class Unsaved:
    """An attribute of an answer that its folder does not hold."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.message = (f"'{name}' of an {owner.__name__} is not in its folder, which holds what it says, not the data "
                        "that it is from; solve the problem again")

    def __get__(self, answer: object, owner: type) -> Any:
        raise AttributeError(self.message)


def _plain(value: Any) -> Any:
    """A number, text, array of floats, or table or sequence of such, as JSON stores it.

    Raises:
        TypeError: it is something else.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if (isinstance(value, float | np.ndarray) and not np.all(np.isfinite(value))) or isinstance(value, np.ndarray):
        if np.asarray(value).dtype.kind != "f" or np.any(np.isinf(value)):
            raise TypeError
        return {"array": np.where(np.isnan(value), np.array(None), value).tolist()}
    if isinstance(value, tuple) and type(value) is tuple:
        return [_plain(each) for each in value]
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return {"table": {key: _plain(each) for key, each in value.items()}}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError


def _restored(value: Any) -> Any:
    """What `_plain` stored."""
    if isinstance(value, list):
        return tuple(map(_restored, value))
    if not isinstance(value, dict):
        return value
    if "array" in value:
        array = np.array(value["array"], dtype=float)
        return array if array.ndim else float(array)
    return {key: _restored(each) for key, each in value["table"].items()}


def _fields(answer: Answer) -> dict[str, Any]:
    """The fields of an answer that JSON can store, by name."""
    found = {}
    for name in getattr(answer, "__dataclass_fields__", {}):
        with suppress(TypeError, AttributeError):
            found[name] = _plain(getattr(answer, name))
    return found


def _stated(folder: Path, saved: Mapping[str, Any], kind: type[Answer]) -> dict[str, Any]:
    """What a folder says of its answer, by the names of an answer's attributes."""
    job, status, method = json_file.Job(saved["job"]), Status(saved["status"]), str(saved["method"])
    machine_id = MachineId(**{key: str(saved["machine"][key]) for key in MachineId._fields})
    reason, own = str(saved.get("reason", "")), saved.get("answer", {})
    verdict = Verdict(json_file.title(machine_id.name, job, method), status, reason)
    if "verdict" in saved:
        said = saved["verdict"]
        verdict = validated(Verdict, said | {"claims": [*saved.get("claims", ()), *said.get("unbounded", ())]})
    diagnostics, findings = (validated(tuple[Diagnostic, ...], saved.get(key, ())) for key in (
        "diagnostics", "findings"))
    checks = {each.remedy for each in (*diagnostics, *findings)}

    def machine(answer: Answer) -> Machine:
        name = f"{machine_id.name}.toml"
        if answer.text_of(name) is not None:
            return load_machine(folder / name)
        if "machine" not in own:
            raise ProblemError("there is no calibrated machine beside it", where=str(folder),
                               remedy="see its 'diagnostics'")
        return read_machine(str(own["machine"]), where=str(folder))

    def fits(sets: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Fit]]:
        known = {data: {channel: {key: math.nan if value is None else value for key, value in entry.items()}
                        for channel, entry in table.items()} for data, table in sets.items()}
        found: dict[str, dict[str, Fit]] = validated(dict[str, dict[str, Fit]], known)
        return found

    fields = {name: _restored(value) for name, value in own.get("fields", {}).items()}
    unsaved = {name: Unsaved() for name in getattr(kind, "__dataclass_fields__", {}) if name not in fields}
    return {
        **fields, **unsaved, "machine": property(machine), "directory": folder, "job": job, "reason": reason,
        "status": status, "method": method, "machine_id": machine_id, "verdict": verdict, "claims": verdict.claims,
        "headline": verdict.finding,
        "next_steps": tuple(step for step in verdict.next_steps if step.text not in checks),
        "diagnostics": diagnostics, "findings": findings,
        "refuted": any(each.meaning is Meaning.REFUTATION for each in diagnostics),
        "parameters": ParameterTable(validated(tuple[ParameterRow, ...], saved.get("parameters", ()))),
        "fit": fits(saved.get("fit", {})),
        "fit_by_model": {name: fits(sets) for name, sets in saved.get("fit_by_model", {}).items()},
        "inputs": validated(tuple[dict[str, Any], ...], saved["inputs"]),
        "details": lambda _: {key: value for key, value in saved.items() if key not in json_file.COMMON},
        "files": lambda _, **__: json_file.Beside(folder, saved),
        "content": lambda _, wall_s=float("nan"): {**saved, "wall_s": number(wall_s)},
        **({"__str__": lambda _: str(own["text"])} if "text" in own else {"__str__": Answer.__str__})}


def load(directory: str | Path) -> Answer:
    """The answer that a command or `Answer.save` wrote into a directory, of the class that `solve` returned.

    It says what that said, and holds its machine, tables and numbers. Attributes that need the data, such as
    `problem`, raise an AttributeError.

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
        kind = _kind(content)
        return object.__new__(type(kind.__name__, (kind,), _stated(folder, content, kind)))
    except (LookupError, ValueError, TypeError, AttributeError, ArithmeticError):
        raise json_file.not_an_answer(folder) from None


def _kind(content: Mapping[str, Any]) -> type[Answer]:
    """The class of the answer in a JSON file."""
    job = json_file.Job(content["job"])
    kinds = {name: module for name, (module, of, _) in KINDS.items() if of == job}
    name = content.get("answer", {}).get("class")
    name = name if name in kinds else next(iter(kinds))
    return cast(type[Answer], getattr(import_module(f"hydroopt.{kinds[name]}"), name))


def _percent(part: float) -> str:
    """A part of one in per cent; a dash for NaN, as of what nothing measures."""
    return f"{100 * part:8.1f} %" if math.isfinite(part) else f"{'–':>8}  "
