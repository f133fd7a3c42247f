"""Kinematic calibration of machine and calibrator from poses, and its answer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from hydroopt.errors import MachineError, ProblemError, SolverError
from hydroopt.estimation.inference.identifiability import FULL
from hydroopt.estimation.kinematic import diagnostics
from hydroopt.estimation.kinematic.accuracy import (
    PredictionTest,
    WorkspaceAccuracy,
    prediction_test,
    workspace_accuracy,
)
from hydroopt.estimation.kinematic.compliance_choice import ComplianceChoice
from hydroopt.estimation.kinematic.initial_guesses import closed_angles, follow_unsensed, guess_unsensed
from hydroopt.estimation.kinematic.left_out import left_out
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.estimation.kinematic.optimum import Optimum, optimum, random_start, solvable, with_farthest_pose
from hydroopt.estimation.kinematic.pose_checks import (
    refuse_planned,
)
from hydroopt.estimation.kinematic.pose_faults import Suspect, SuspectKind
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.estimation.kinematic.residuals import (
    ChainSides,
    PoseResiduals,
    chain_sides,
    groups,
    loop_fit,
    predicted,
    residual_sizes,
    table_of,
)
from hydroopt.estimation.kinematic.solution import JOINT, KinematicSolution, uniqueness
from hydroopt.estimation.kinematic.suspects import find_suspects
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine
from hydroopt.model.scene_graph import SceneGraph
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.fit import Fit
from hydroopt.results.json_file import Job, MachineId
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.status import Status
from hydroopt.results.tables import COVARIANCE, covariance_csv, csv_text, number
from hydroopt.results.verdict import NORMAL, About, Action, Claim, NextStep, Purpose, Usable, determined, judged
from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(KinematicSolution, Answer):
    """Calibrated geometry of a machine; `hydroopt.solve` returns it.

    Attributes:
        all_poses: the calibration with all poses, if those that contradict the others were left out afterwards.
        compliance_choice: which joints give way, if that was chosen by held-out poses.

    >>> import hydroopt
    >>> from hydroopt.simulation.pose_table import simulate_poses
    >>> machine = hydroopt.load_machine("panda_mukca")
    >>> plan = hydroopt.solve(hydroopt.pose_problem(machine, 20), candidates=50)
    >>> measured = simulate_poses(hydroopt.KinematicModel(machine), plan.postures, random=True, noise=False)
    >>> calibration = hydroopt.solve(hydroopt.calibration_problem(machine, measured.poses, priors=False))
    >>> calibration.status, calibration.parameters["panda_joint3.d"].kind
    (<Status.OK: 'ok'>, 'length')
    >>> bool(abs(calibration["panda_joint3.d"].value - measured.truth["panda_joint3.d"]) < 1e-6)
    True
    """

    all_poses: Calibration | None = None
    compliance_choice: ComplianceChoice | None = None

    job = Job.CALIBRATION

    @property
    def machine_id(self) -> MachineId:
        """Which machine it is about."""
        return MachineId.of(self.problem.model.machine)

    @property
    def method(self) -> str:
        """How it was calibrated, ``joint`` or ``hierarchical``."""
        return self.algorithm

    @property
    def fit(self) -> Mapping[str, Mapping[str, Fit]]:
        """By ``nominal``, ``train`` and ``validation``, then by channel: RMS [m] and VAF (Eq. 3.44-3.46)."""
        return self.fits

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of the calibration, the most severe first."""
        before = len((self.all_poses or self).problem.poses)
        return tuple(diagnostics.diagnose(self, tested=self.tested, left_out=self.left_out,
                                          poses_left_out=before - len(self.problem.poses)))

    @cached_property
    def parameters(self) -> ParameterTable:
        """Geometry, fixtures and angles of locked joints; without a value where neither poses nor priors give one."""
        stated, known = self.problem.parameters, self.problem.known
        rows = []
        for k, name in enumerate(stated.names):
            given = bool(self.determined[k])
            rows.append(row(
                name, stated.kinds[k], stated.units[k], nominal=stated.nominal[k],
                prior_std=1 / known[k] if known[k] else np.nan, value=self.theta[k] if given else np.nan,
                std=self.std[k] if given else np.nan, ci95=self.ci95[k] if given else (np.nan, np.nan),
                bound=stated.nearest_bound(k, self.theta[k]) if self.at_bound[k] else "",
                identifiability=self.category(name)))
        return ParameterTable(rows)

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """How well it places the machine's end, and which dimensions the poses determine."""
        held_out = "no held-out poses" if self.problem.validation is None else "tested on held-out poses"
        if self.tested is not None:
            held_out = f"errors of held-out poses {self.tested.ratio:.2g} times those stated"
        return (*self._unseen(), self._end(held_out), *(determined(Purpose.LENGTH, each, condition="95 % intervals",
                                  unknown="not determined by the poses") for each in self.parameters.rows))

    def _unseen(self) -> Iterator[Claim]:
        """How well the end's place is predicted, as the same sensors read it, in poses that took no part."""
        name = next((name for name in ("gap", "tip") if name in self.fit["train"]), "")
        rank = self.linearised.rank.sum()
        if not name or self.algorithm != JOINT or not rank:
            return
        by_places, left = left_out(self.problem, self.linearised)
        if not len(left.counts):
            return
        bound = float(self.fit["train"][name].rms * left.bound[0] / np.sqrt(self.linearised.pose_square.sum() / rank))
        extent = float(np.linalg.norm(np.ptp(self.workspace.position, axis=0))) / 2
        low, high = np.quantile(self.workspace.measured[:, 2], [0.0, 1.0])
        among = f"{len(left.counts)} {'places' if by_places else 'blocks of poses'}, each predicted without it"
        beyond = "heights" if by_places else "places and heights"
        condition = (f"RMS of poses like those of the {among}, at heights of {low:.2f} to {high:.2f} m; other {beyond} "
                     "are not covered: measure there")
        yield judged(Purpose.POSITION, self.workspace.point, bound, "m", bound / extent if extent else np.nan,
                     condition=condition, about=About.READING,
                     untested="" if left.tested[0] else "too few poses can be predicted without them")

    def _end(self, held_out: str) -> Claim:
        """How well it places the machine's end."""
        workspace = self.workspace
        exact = ", ".join(workspace.exact)
        if not workspace.moved:
            return Claim(Purpose.POSITION, workspace.point, Usable.UNTESTED, reason=(
                f"the machine file states no sigma of {exact or 'any number that moves it'}"))
        half, extent = NORMAL * workspace.largest_std, float(np.linalg.norm(np.ptp(workspace.position, axis=0))) / 2
        return judged(
            Purpose.POSITION, workspace.point, half, "m", half / extent if extent else np.nan,
            condition="; ".join(["95 %, by the intervals", *([f"{exact} as stated"] if exact else []), held_out]),
            reason="" if np.all(np.isfinite(workspace.std)) else "the poses do not determine all that moves it")

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """Which poses to correct, which to measure, or how to use it."""
        steps = []
        wrong = [each.place for each in self.suspects if each.kind.is_poses and each.decided]
        if wrong and not self.command_line.given("--without-suspects"):
            steps.append(NextStep(Action.CHECK, f"Correct {', '.join(wrong[:3])}, or leave out what contradicts the "
                                  "others:", self.command_line.again("--without-suspects")))
        named = [each.kind for suspect in self.suspects for each in (suspect, *suspect.rivals)]
        if SuspectKind.SAG in named and not self.command_line.given("--compliance"):
            steps.append(NextStep(Action.CHECK, "Take in joints that give way under gravity, as far as other poses are "
                                  "predicted better:", self.command_line.again("--compliance", "auto")))
        if self.problem.validation is None:
            steps.append(NextStep(Action.MEASURE, "Measure ten more poses and give them as --validate: they test it."))
        if weak := [claim.of for claim in self.claims if claim.usable is Usable.NO and claim.purpose is Purpose.LENGTH
                    and self.category(claim.of) == FULL]:  # of the others, more poses may tell nothing either
            steps.append(NextStep(Action.MEASURE, f"For {weak[0]}, plan more poses and measure them:", (
                f"hydroopt plan-poses {self.problem.model.machine.source} --focus {weak[0]} -n 20 -o poses")))
        if not self.workspace.moved and self.workspace.exact:
            steps.append(NextStep(Action.STATE, (
                f"Where the tip's place matters, state a sigma of {', '.join(self.workspace.exact)}, and what measures "
                "the tip, a calibrator or a tracker, in the machine file.")))
        if self.written.machine is not None and self.status is Status.OK:
            steps.append(NextStep(Action.USE, *self.using_machine))
        return tuple(steps)

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The tables of poses."""
        return inputs_of((self.all_poses or self).problem)

    @cached_property
    def machine(self) -> Machine:
        """The machine with the calibrated geometry and its confidences.

        Raises:
            MachineError: no machine can have this geometry.
        """
        if self.written.machine is None:
            raise MachineError(self.written.reason.rstrip("."), where=f"machine '{self.machine_name}'",
                               remedy="correct limits in the machine file, or fix parameters")
        return self.written.machine

    @property
    def left_out(self) -> tuple[Suspect, ...]:
        """Suspects whose poses were left out."""
        return () if self.all_poses is None else tuple(s for s in self.all_poses.suspects if s.kind.is_poses)

    @cached_property
    def residuals(self) -> tuple[PoseResiduals, ...]:
        """Of the training poses, then of those held out."""
        problem = self.problem
        nominal = follow_unsensed(problem, problem.start, guess_unsensed(problem, problem.start))
        units = {name: unit for name, (_, unit) in groups(problem).items()}
        roles = {"train": (problem.poses, (problem, problem.start, nominal), (problem, self.theta, self.q))}
        if problem.validation is not None:
            before, after = (predicted(problem, theta, problem.validation) for theta in (problem.start, self.theta))
            roles["validation"] = problem.validation, before, after
        found = [(role, poses, residual_sizes(*before), residual_sizes(*after))
                 for role, (poses, before, after) in roles.items()]
        return tuple(PoseResiduals(*each, {name: units[name] for name in each[3]}) for each in found)

    @cached_property
    def sides(self) -> tuple[ChainSides, ...]:
        """The machine's side of the closed chain against the calibrator's and taped distances (Tables 8 and 10)."""
        problem = self.problem
        found = [*chain_sides(problem, problem.start, "nominal", "train"),
                 *chain_sides(problem, self.theta, "calibrated", "train")]
        if problem.validation is not None:
            for geometry, theta in (("nominal", problem.start), ("calibrated", self.theta)):
                fresh, own, _ = predicted(problem, theta, problem.validation)
                found += chain_sides(fresh, own, geometry, "validation")
        return tuple(found)

    @cached_property
    def scene(self) -> SceneGraph:
        """The bodies of machine and calibrator as calibrated."""
        return self.problem.model.scene_graph(self.theta[: len(self.problem.model.parameters)])

    @property
    def held_at(self) -> Array:
        """Places (k, 3) [m] of fixtures that hold the tip in the training poses, each once."""
        places = self.problem.places(self.theta)[self.problem.layout.held, :3]
        return np.unique(np.round(places, 3), axis=0)

    @cached_property
    def workspace(self) -> WorkspaceAccuracy:
        """Accuracy of the machine's end over its workspace."""
        return workspace_accuracy(self)

    @cached_property
    def tested(self) -> PredictionTest | None:
        """The held-out poses against the error stated for them; None without such poses or without intervals."""
        if self.problem.validation is None or self.algorithm != JOINT:
            return None
        return prediction_test(self, self.problem.validation)

    def __str__(self) -> str:
        lines = [f"{self.machine_name} by {self.method}: {self.status}, {len(self.problem.poses)} poses, "
                 f"errors {self.noise_scale:.2f} times those stated"]
        lines += [f"  {data:<10} {channel:<24} RMS {1e3 * fit.rms:9.3f} m{fit.unit}  VAF {100 * fit.vaf:7.3f} %"
                  for data, table in self.fit.items() for channel, fit in table.items()]
        lines += [f"  stage {stage}" for stage in self.stages]
        lines += [f"  {sides}" for sides in self.sides]
        return "\n".join(lines)

    def details(self) -> Mapping[str, Any]:
        """Conditioning, correlations, suspects, uniqueness, accuracy over the workspace [m], and settings."""
        identified, workspace, tested = self.observability, self.workspace, self.tested
        freedom = int(self.linearised.rank.sum()) + len(self.problem.distances.length) - identified.rank
        chosen = {} if self.compliance_choice is None else {"compliance_choice": self.compliance_choice.as_dict()}
        before = () if self.all_poses is None else [_suspect(self.all_poses.problem.poses, s) for s in self.left_out]
        return {
            "combinations": [{"parameters": list(group)} for group in self.combinations],
            "conditioning": {"rank": identified.rank, "condition_number": number(identified.condition_number),
                             "noise_amplification_index": number(identified.noise_amplification_index),
                             "parameters": len(identified.names), "degrees_of_freedom": freedom},
            "correlations": [{"name": name, "other": other, "correlation": r}
                             for name, (other, r) in self.correlations.items()],
            "noise_scale": number(self.noise_scale),
            "validation_coverage": None if tested is None else number(tested.coverage),
            "validation_ratio": None if tested is None else number(tested.ratio),
            "suspects": [_suspect(self.problem.poses, s) for s in self.suspects],
            "left_out": list(before), "uniqueness": self.uniqueness.as_dict(),
            "workspace": {"point": workspace.point, "median_std": number(workspace.median_std),
                          "largest_std": number(workspace.largest_std)},
            "stages": [stage.as_dict() for stage in self.stages],
            "sides": [entry for sides in self.sides for entry in sides.entries()],
            "loss": self.problem.loss, "priors": self.problem.priors, "fixed": dict(self.problem.fixed),
            "seed": self.seed, **chosen}

    def files(self) -> Mapping[str, str]:
        """Tables as CSV, and the calibrated machine where one can exist."""
        files = {"parameters.csv": self.parameters.to_csv(), "residuals.csv": csv_text(self._residual_rows()),
                 "fit.csv": csv_text([{"data": data, "channel": channel, **fit.as_dict()}
                                      for data, table in self.fit.items() for channel, fit in table.items()])}
        known = [k for k, name in enumerate(self.observability.names)
                 if np.isfinite(self.std[self.problem.parameters.index(name)])]
        if known:
            files[COVARIANCE] = covariance_csv(
                [self.observability.names[k] for k in known],
                self.observability.covariance[np.ix_(known, known)] * max(1.0, self.noise_scale) ** 2)
        if self.sides:
            roles = {"train": self.problem.poses, "validation": self.problem.validation}
            files["sides.csv"] = csv_text(table_of(self.sides, {role: poses.row for role, poses in roles.items()
                                                                if poses is not None}))
        if self.written.machine is not None:
            files[f"{self.machine_name}.toml"] = dump_machine(self.marked(self.written.machine))
        return files

    def _residual_rows(self) -> list[dict[str, Any]]:
        """One row a pose: its residuals [m] at the nominal and at the calibrated geometry."""
        rows = []
        units = {channel: unit for part in self.residuals for channel, unit in part.units.items()}
        for part in self.residuals:
            poses = part.poses
            for k in range(len(poses)):
                suspect = part.role == "train" and self.suspicious[k]
                entry: dict[str, Any] = {
                    "data": part.role, "path": str(poses.file[k]), "row": int(poses.row[k]),
                    "stage": str(poses.stage[k]), "fixture": str(poses.fixture[k]), "pose": str(poses.pose[k]),
                    "suspect": int(suspect)}
                for channel, unit in units.items():
                    for when, table in (("before", part.before), ("after", part.after)):
                        entry[f"{channel}_{when} [{unit}]"] = number(table[channel][k]) if channel in table else None
                rows.append(entry)
        return rows


def inputs_of(problem: CalibrationProblem) -> tuple[Mapping[str, Any], ...]:
    """The files that the poses of a problem come from."""
    roles = (("train", problem.poses), ("validation", problem.validation))
    return tuple({"path": path or poses.name, "sha256": poses.sha256.get(path),
                  "samples": int(np.sum(poses.file == path)), "role": role}
                 for role, poses in roles if poses is not None for path in dict.fromkeys(map(str, poses.file)))


def _suspect(poses: Poses, suspect: Suspect) -> dict[str, Any]:
    """`rows` are the files' data rows, `poses` the positions from 1 among the poses of this role."""
    return {"kind": str(suspect.kind), "name": suspect.name, "text": suspect.diagnostic.text,
            "strength": number(suspect.strength), "size": number(suspect.size),
            "rivals": [{"kind": str(rival.kind), "name": rival.name, "text": rival.phrase,
                        "strength": number(rival.strength), "size": number(rival.size)} for rival in suspect.rivals],
            "rows": poses.row[suspect.poses].tolist(), "poses": (np.flatnonzero(suspect.poses) + 1).tolist(),
            "paths": list(dict.fromkeys(map(str, poses.file[suspect.poses])))}


def calibrate(problem: CalibrationProblem, method: str = "joint", *, starts: int = 1, seed: int = 0) -> Calibration:
    """Solve a kinematic calibration.

    Args:
        problem: what to calibrate from which poses.
        method: ``joint`` or ``hierarchical``.
        starts: number of initial guesses; the first is the nominal machine, the others are drawn about it with its
            confidences.
        seed: of the other initial guesses, and of the postures that stand for the workspace.

    Raises:
        ProblemError: unknown method, or the poses cannot determine the parameters.
        SolverError: no trustworthy answer.
    """
    if starts < 1:
        raise ProblemError(f"{starts} initial guesses are too few", where="--starts", remedy="ask for one or more")
    refuse_planned(problem)
    return _calibrated(problem, method, starts=starts, seed=seed)


def _calibrated(problem: CalibrationProblem, method: str, *, starts: int, seed: int) -> Calibration:
    """The calibration of poses that were measured."""
    problem = solvable(problem, method)
    rng = np.random.default_rng(seed)
    answers: list[Optimum] = []
    failed = 0
    for k in range(starts):
        try:
            answers.append(optimum(problem, method, random_start(problem, rng) if k else problem.start))
        except SolverError as error:
            if starts == 1 or (k == starts - 1 and not answers):
                raise with_farthest_pose(problem, error) from None
            failed += 1
    answers.sort(key=lambda answer: answer.cost)
    _, theta, q, stages = answers[0]
    linearised = linearise(problem, theta, closed_angles(problem, theta, q))
    identified = observability(problem, linearised)
    determined = int(np.sum(np.isfinite(identified.std)))
    freedom = int(linearised.rank.sum()) + len(linearised.shared_residual) - determined
    squares = float(linearised.pose_square.sum() + np.sum(linearised.shared_residual**2))
    scale = float(np.sqrt(squares / freedom)) if freedom > 0 else float("nan")
    nominal = follow_unsensed(problem, problem.start, guess_unsensed(problem, problem.start))
    fits = {"nominal": loop_fit(problem, problem.start, nominal), "train": loop_fit(problem, theta, q)}
    if problem.validation is not None:
        fits["validation"] = loop_fit(*predicted(problem, theta, problem.validation))
    return Calibration(problem, method, theta, q, identified, linearised, scale, fits,
                       find_suspects(problem, q, linearised, identified),
                       uniqueness(identified, [answer[:2] for answer in answers], failed, problem.free), seed, stages)


def without_suspects(calibration: Calibration, *, starts: int = 1) -> Calibration:
    """The calibration solved again without the poses that contradict the others; unchanged where there are none.

    Args:
        calibration: with all poses; the answer keeps it as `all_poses`.
        starts: as for `calibrate`.

    Raises:
        ProblemError, SolverError: see `calibrate`.
    """
    if not np.any(calibration.suspicious):
        return calibration
    solved = _calibrated(calibration.problem.without(calibration.suspicious), calibration.algorithm, starts=starts,
                         seed=calibration.seed)
    return replace(solved, all_poses=calibration)
