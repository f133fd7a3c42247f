"""Logs made ready for identification: no samples twice, and mistakes in them by name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hydroopt.checks.plausibility import LOG_MISREAD, contradiction, examine, misread_error, remedy_of
from hydroopt.errors import HydrooptError, ProblemError, SolverError
from hydroopt.estimation.dynamic.experiment import Experiment, experiment, refuse_nothing_to_determine
from hydroopt.estimation.dynamic.lagging_forces import refuse_lags
from hydroopt.logs.calibrator_angles import calibrator_channels
from hydroopt.logs.dead_channels import without_dead_channels
from hydroopt.logs.forces_from_pressures import absent_forces
from hydroopt.logs.log import SAMPLE, Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.model.model import Model
from hydroopt.results.diagnostic import Diagnostic, in_samples, listed, of_kind

FORCE_NOT_MEASURED = "force not measured in a log"
"""Kind of the diagnostic of a log that lacks channels of actuators."""


def prepared(log: Log, model: Model, smoothing: Smoothing | None) -> Experiment:
    """A log as an experiment.

    Raises:
        ProblemError: there is nothing to determine.
        LogError, ProblemError: it cannot be used; the mistake in it that explains this is named, if there is one.
    """
    refuse_nothing_to_determine(model)
    try:
        return experiment(model, without_dead_channels(model.machine, log), smoothing)
    except HydrooptError as error:
        raise misread_error(model, log) or error from None


def contradictions(model: Model, experiments: Sequence[Experiment]) -> tuple[Diagnostic, ...]:
    """What contradicts the machine file in the logs as they are read; both parts of a split log as one."""
    logs: dict[str, Log] = {}
    for data in experiments:
        name, log = data.log.sha256 or str(id(data.log)), data.log
        before = logs.get(name)
        logs[name] = log if before is None else _both_parts(before, log)
    return tuple(found for log in logs.values() for found in examine(model, log))


def _both_parts(first: Log, second: Log) -> Log:
    """A log of two parts of one file as it was before the split, with the channels of both; the first one alone where
    it is long, or samples do not follow."""
    if first.size > SAMPLE or second.sample[0] <= first.sample[-1]:
        return first
    return replace(first, t=np.concatenate([first.t, second.t]), recording=None,
                   channels={name: np.concatenate([values, second.channels[name]])
                             for name, values in first.channels.items() if name in second.channels},
                   sample=np.concatenate([first.sample, second.sample]),
                   segment=np.concatenate([first.segment, second.segment]))


def forces_not_measured(model: Model, experiments: Sequence[Experiment]) -> Iterator[Diagnostic]:
    """Logs that do not tell the force of a measured actuator; both parts of a split log as one."""
    absent = {data.log.path or data.log.name: lacking for data in experiments
              if (lacking := absent_forces(model, data.log))}
    for where, lacking in absent.items():
        channels = listed([channel for some in lacking.values() for channel in some])
        yield Diagnostic.of(FORCE_NOT_MEASURED, tuple(lacking), {"log": where, "channels": channels}, (
            "{log} lacks {channels}: the equations of {subject} are not used there, those of other actuators are."),
            "Record or map what is missing; state measured = false of an actuator that is never measured.")


def losses(model: Model, experiments: Sequence[Experiment]) -> tuple[Diagnostic, ...]:
    """What logs lack: forces, and samples without a number."""
    samples = (in_samples(data.log.path or data.log.name, finding.text)
               for data in experiments for finding in data.log.findings if finding.kind in ("nan", "dead"))
    return (*forces_not_measured(model, experiments), *samples)


def explained(error: HydrooptError, of_logs: Sequence[Diagnostic]) -> HydrooptError:
    """The mistake in a log that explains an error, if there is one, or else the error."""
    misread = of_kind(of_logs, LOG_MISREAD)
    return SolverError(contradiction(misread[0]), where=str(misread[0].evidence["log"]),
                       remedy=remedy_of(misread[0])) if misread else error


def refuse_added(what: str, experiments: Sequence[Experiment]) -> None:
    """Refuse logs with a calibrator attached or with forces that lag, which `what` cannot be combined with.

    Raises:
        ProblemError: there is one.
    """
    for data in experiments:
        refuse_lags(what, data.model, data.log)
        if data.model.calibrator and calibrator_channels(data.model.machine, data.log):
            raise ProblemError(f"{what} cannot be combined with an attached calibrator",
                               where=data.log.path or data.log.name, remedy="choose one of the two")


def refuse_repetition(logs: Sequence[Log]) -> None:
    """Refuse the same samples twice: they would count twice, or validate an estimate by its training data."""
    for k, log in enumerate(logs):
        for other in logs[:k]:
            same = log is other or (log.sha256 and log.sha256 == other.sha256)
            if same and log.rows[0] <= other.rows[1] and other.rows[0] <= log.rows[1]:
                raise ProblemError("the same samples are given twice", where=log.path or log.name,
                                   remedy="give each log once, and hold out another one or --holdout to judge by")
