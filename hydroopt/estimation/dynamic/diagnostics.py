"""What a user should doubt about an estimate, in plain words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.calibrated import calibrated_machine
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.inference.identifiability import NONE, Confounded
from hydroopt.logs.readings import force_noise
from hydroopt.parameters.dynamic import bodies
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet

_EFFECTS = {ParameterKind.MASS: "gravity", ParameterKind.FIRST_MOMENT: "gravity",
            ParameterKind.MOMENT_OF_INERTIA: "inertia", ParameterKind.STRIBECK_SPEED: "Stribeck friction"}
"""What parameters of a kind cause, where that is not the name of the kind."""


def doubts(estimate: Estimate) -> tuple[str, ...]:
    """Sentences, the gravest first; none if nothing is in doubt."""
    said = (*_prediction(estimate), *_impossible(estimate), *_noise(estimate),
            *_confounded(estimate.problem.parameters, estimate.confounded), *_unseen(estimate),
            *_held(estimate), *_sampling(estimate), *_confidences(estimate), *_heavy(estimate),
            *_findings(estimate))
    return tuple(dict.fromkeys(said))


def _prediction(estimate: Estimate) -> list[str]:
    fit = estimate.fit
    if "validation" not in fit:
        return ["No log was held out, so how well unseen forces are predicted is not known: give --validate or "
                "--holdout."]
    said = []
    for name, held_out in fit["validation"].items():
        trained = fit["train"][name]
        if name == "all":
            continue
        if held_out.relative > 1:
            said.append(f"Unseen forces of {name} are predicted worse than by zero "
                        f"({100 * held_out.relative:.0f} % error).")
        elif held_out.vaf < 0:
            said.append(f"Unseen forces of {name} are off by a constant of their own: the mean of the signal would "
                        "have followed it more closely.")
        elif held_out.rms > 2 * trained.rms:
            said.append(f"Unseen forces of {name} are predicted with {held_out.rms / trained.rms:.1f} times the error "
                        "of the training data: the model is overfitted there, or the motion is of another kind.")
    return said


def _impossible(estimate: Estimate) -> list[str]:
    bad = [owner for owner, smallest in estimate.consistency.items() if smallest < 0]
    if bad:
        return [f"No such body can exist: {', '.join(bad)}. Their numbers reproduce forces but mean nothing one by "
                "one, and no calibrated machine is written; the method 'sdp' keeps bodies possible."]
    try:
        calibrated_machine(estimate)
    except ProblemError as error:
        return [f"No calibrated machine is written: {error.what}; {error.remedy}."]
    return []


def _confounded(parameters: ParameterSet, found: Sequence[Confounded]) -> list[str]:
    """One sentence for each set of parameters that stand in for one another, the smallest sets first."""
    groups: list[set[str]] = []
    for one in found:
        joined = {one.name, *one.partners}
        for group in [g for g in groups if g & joined]:
            groups.remove(group)
            joined |= group
        groups.append(joined)
    said = []
    for group in sorted(groups, key=len):
        effects = sorted({_EFFECTS.get(kind := parameters.kind(name), kind.value) for name in group})
        subject = effects[0] if len(effects) == 1 else f"{', '.join(effects[:-1])} and {effects[-1]}"
        worst = max(one.inflation for one in found if one.name in group)
        said.append(f"Not separable in this motion: {subject} ({_some(sorted(group), 6)}), whose variances are up to "
                    f"10^{np.log10(worst):.0f} times what they would be if the others were known.")
    if said:
        said.append("Of what is not separable these data tell only the joint effect, and priors the rest: reverse the "
                    "motion, vary its speed and reach, or state what you know.")
    return said


def _noise(estimate: Estimate) -> list[str]:
    said = []
    stated = force_noise(estimate.problem.model, estimate.problem.experiments[0].log)
    units = estimate.problem.model.force_units
    for k, actuator in enumerate(estimate.problem.model.machine.actuators):
        if np.isfinite(stated[k]) and estimate.sigma[k] > 1.5 * stated[k]:
            said.append(f"Residuals of {actuator.name} are {estimate.sigma[k] / stated[k]:.1f} times its sensors' "
                        f"noise of {stated[k]:.3g} {units[k]}: noisy angles, or effects the model does not have.")
    slow = [f"{a.name} ({t:.0f} samples)" for a, t in zip(estimate.problem.model.machine.actuators,
                                                          estimate.correlation_time, strict=True) if t > 3]
    if slow:
        said.append(f"Residuals repeat themselves: {', '.join(slow)}. Something is missing in the model, or angles are "
                    "noisy; intervals are widened accordingly.")
    return said


def _unseen(estimate: Estimate) -> list[str]:
    parameters = estimate.problem.parameters
    said = []
    not_excited = [name for k, name in enumerate(parameters.names) if estimate.identifiability(k) == "not excited"]
    if not_excited:
        said.append(f"This motion does not show what the machine could show: {_some(not_excited)}.")
    never = [name for k, name in enumerate(parameters.names) if estimate.structure.category[k] == NONE]
    if never:
        said.append(f"No motion shows {_some(never)}.")
    return said


def _held(estimate: Estimate) -> list[str]:
    held = _some(list(estimate.active))
    return [f"At the most probable point held by constraints: {held}."] if held else []


def _sampling(estimate: Estimate) -> list[str]:
    if any("HAD NOT SETTLED" in note for note in estimate.notes):
        return ["The sampling of the intervals had not settled: do not rely on them."]
    return [note[0].upper() + note[1:] + "." for note in estimate.notes if note.startswith("no intervals: ")]


def _confidences(estimate: Estimate) -> list[str]:
    """Bodies whose file states no confidence got one by default."""
    model = estimate.problem.model
    silent = [owner for owner, owned in bodies(model.machine, actuator_inertia=model.actuator_inertia).items()
              if not any(note.sigma for path, note in model.machine.notes.items() if path.startswith(f"{owned.path}."))]
    if not silent or estimate.method not in ("sdp", "qp", "nlp"):
        return []
    return [f"No confidence is stated for {_some(silent)}: 100 % of their size is assumed."]


def _heavy(estimate: Estimate) -> list[str]:
    """Bodies whose log-det distance is so weak that it lets them grow more than it lets them shrink."""
    problem = estimate.problem
    grown = {body.owner: body.spread for body in problem.bodies if body.weight and body.spread > 2}
    if not grown:
        return []
    return [f"The log-det distance of {_some(list(grown))} is weak: before any data the mean of its bodies is up to "
            f"{max(grown.values()):.0f} times the nominal one. State the confidence of their masses, at most 30 %."]


def _findings(estimate: Estimate) -> list[str]:
    return [f"{data.log.path or data.log.name}: {finding.text}" for data in
            (*estimate.problem.experiments, *estimate.problem.validation) for finding in data.log.findings
            if finding.kind not in ("rows", "ignored")]


def _some(names: Sequence[str], most: int = 8) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
