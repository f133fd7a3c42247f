"""One run: a machine file, a log, an answer, and which of its claims come true."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

import hydroopt as ho
from hydroopt.errors import HydrooptError
from studies.verdicts.kinds import OTHER_FRICTION, Kind, kind
from studies.verdicts.machines import COM as COM_SIGMA
from studies.verdicts.machines import FRICTION, INERTIA, MACHINES, MASS, Array, Truth, machine_file
from studies.verdicts.plant import plant
from studies.verdicts.recording import Effects, Recording, read_forces, record

TRAIN, UNSEEN = 60.0, 40.0
"""Seconds of the log and of the motion that is predicted."""
SEEN = 3.29
"""Standard normal limit of a two-sided test at p < 1e-3."""
SAID_IN_WORDS = {"exchanged": ("exchanged", "swap"), "pin": ("pin",), "offset": ("offset",), "delay": ("late", "early"),
                 "gain": ("gain",), "tilt": ("tilt",)}
"""Words of a refusal that name a fault without a diagnostic's `fault`."""


def case(machine: str, name: str, size: int, seed: int, motion: int | None = None) -> dict[str, Any]:
    """What one run says and what comes true; `motion` is the seed of the motion where it is not the run's."""
    truth = MACHINES[machine]
    own = kind(truth, name, size)
    row: dict[str, Any] = {"machine": machine, "kind": name, "size": size, "seed": seed, "motion": motion,
                           "fault": own.fault}
    train, unseen = (record(truth, own.effects, seed, which, seconds, motion)
                     for which, seconds in ((0, TRAIN), (1, UNSEEN)))
    text = machine_file(truth, seed, own.stated)
    began = time.process_time()
    estimate: ho.Estimate | None = None
    error = ""
    try:
        stated = ho.read_machine(text)
        problem = ho.identification_problem(stated, [ho.Log("log", train.t, train.channels)])
        estimate = ho.solve(problem, seed=1)
        status, diagnostics = str(estimate.status), estimate.diagnostics
        claims = [each for each in estimate.verdict.claims if str(each.purpose) == "force" and each.bound is not None]
    except HydrooptError as refusal:
        status, diagnostics, claims, error = "refused", (), [], str(refusal)
    row |= {"status": status, "cpu_s": round(time.process_time() - began, 2), "error": error}
    row["contradictions"] = [_said(each) for each in diagnostics if each.contradicts]
    row["notes"] = [_said(each) for each in diagnostics if not each.contradicts and each.evidence.get("fault")]
    if estimate is not None:
        row["first_line"] = estimate.verdict.cause
        row |= _bounds(truth, own, stated, estimate, claims, train, unseen)
        row |= _intervals(truth, estimate)
    if own.fault:
        row |= _witness(truth, own, seed, train, row, estimate)
    return row


def _said(each: Any) -> dict[str, Any]:
    return {"kind": each.kind, "fault": each.evidence.get("fault", ""), "tied": list(each.evidence.get("tied", [])),
            "text": each.text[:200]}


def named(row: dict[str, Any]) -> str:
    """Whether the cause that is named first, or is tied with it, is right; wrong; or none."""
    own, said = kind(MACHINES[row["machine"]], row["kind"], row["size"]), row["contradictions"]
    for each in said:
        if each["fault"]:
            right = any(name.startswith(word) for name in (each["fault"], *each["tied"]) for word in own.named)
            return "right" if right else "wrong"
    words = [word for name in own.named for word in SAID_IN_WORDS.get(name.partition(" ")[0], ())]
    text = " ".join([row["error"], *(f"{each['kind']} {each['text']}" for each in said)]).lower()
    return "right" if any(word in text for word in words) else "none"


def _bounds(truth: Truth, own: Kind, stated: ho.Machine, estimate: ho.Estimate, claims: list[Any], train: Recording,
            unseen: Recording) -> dict[str, Any]:
    """Errors of forces on the unseen motion, where it is within the region of the log's, against their bounds."""
    held, = ho.identification_problem(stated, [ho.Log("unseen", unseen.t, unseen.channels)]).experiments
    predicted = estimate.predict(held)
    at = np.searchsorted(unseen.t, held.motion.t)
    within = np.all([(each[at] >= old.min(axis=0)) & (each[at] <= old.max(axis=0)) for each, old in (
        (unseen.q, train.q), (unseen.qd, train.qd), (unseen.qdd, train.qdd))], axis=(0, 2))
    used = (held.inside & within)[:, None] & held.known
    measured = {"reading": read_forces(truth, unseen, own.stated.bore), "truth": unseen.force}
    found = []
    for each in claims:
        k = next((k for k, name in enumerate(truth.actuators) if name == each.of), None)
        k = k if k is not None else next(k for k, joint in enumerate(truth.joints) if joint.name == each.of)
        off = (measured[str(each.about)][at, k] - predicted[:, k])[used[:, k]]
        rms = float(np.sqrt(np.mean(off**2)))
        size = float(np.sqrt(np.mean(unseen.force[:, k] ** 2)))
        found.append({"of": each.of, "about": str(each.about), "bound": float(each.bound), "actual": rms,
                      "part": rms / size, "usable": str(each.usable)})
    holds = {about: all(each["actual"] <= each["bound"] for each in found if each["about"] == about)
             for about in ("reading", "truth")}
    return {"claims": found, "reading_true": holds["reading"], "truth_true": holds["truth"]}


def _intervals(truth: Truth, estimate: ho.Estimate) -> dict[str, Any]:
    """Normalised errors of base parameters."""
    psi = _true_psi(truth, estimate.problem.parameters.names)
    base = estimate.identifiability
    z = (estimate.base_value - base.grouping @ psi) / _stated(estimate)
    names = [estimate.problem.parameters.names[k] for k in base.basis]
    return {"z": {name: round(float(value), 2) for name, value in zip(names, z, strict=True)}}


def _stated(estimate: ho.Estimate) -> Array:
    """Standard deviations of base parameters, as they are stated."""
    return np.array([each["std"] for each in estimate.base_parameters], dtype=float)


def _true_psi(truth: Truth, names: tuple[str, ...]) -> Array:
    known = truth.parameters()
    return np.array([known.get(name, 0.0) for name in names])


@lru_cache(maxsize=8)
def columns(machine: str, seed: int, which: int, seconds: float) -> tuple[tuple[str, ...], Array, Array]:
    """Owners and names of numbers, what one σ of each does to efforts (N, n, p), and to inertial parameters."""
    truth = MACHINES[machine]
    run = record(truth, Effects(), seed, which, seconds)
    states, made, names, sigma = (run.q, run.qd, run.qdd), [], [], []
    before, levers, _ = plant(truth).efforts(*states)
    for owner, body in truth.bodies().items():
        # numbers as a file states them: steps of mass, centre of mass along x and y, and moments of inertia
        steps = [(replace(body, m=1.01 * body.m), MASS * body.m / (0.01 * body.m)),
                 (replace(body, com=(body.com[0] + 1e-3, *body.com[1:])), COM_SIGMA / 1e-3),
                 (replace(body, com=(body.com[0], body.com[1] + 1e-3, body.com[2])), COM_SIGMA / 1e-3),
                 (replace(body, inertia=tuple(1.01 * np.array(body.inertia))), INERTIA / 0.01)]
        for changed, factor in steps:
            after = plant(truth.with_body(owner, changed)).efforts(*states)[0]
            made.append((after - before) * factor)
            names.append(owner)
            sigma.append(factor * (changed.numbers() - body.numbers()))
    for k, joint in enumerate(truth.joints):
        own = next((each for each in truth.cylinders if each.joint == k), joint)
        speed = run.qd[:, k] * levers[:, k]
        for key, course in (("coulomb", np.sign(speed) * own.coulomb), ("viscous", speed * own.viscous)):
            column = np.zeros_like(before)
            column[:, k] = FRICTION * course
            made.append(column)
            owner = f"{own.name}.f" if truth.cylinders and own is not joint else f"{joint.name}_drive.tau"
            names.append(f"{owner}_{key}")
            sigma.append(np.array([FRICTION * getattr(own, key)]))
    return tuple(names), np.stack(made, axis=2), np.array(sigma, dtype=object)


def _witness(truth: Truth, own: Kind, seed: int, train: Recording, row: dict[str, Any],
             estimate: ho.Estimate | None) -> dict[str, Any]:
    """What a test that is given the fault says of it, and how far it moves claims and intervals that are stated.

    The test is that of the likelihood ratio: readings less the true model's, by the true motion and the instruments'
    noise, with every parameter known as well as the file states it.
    """
    names, X, steps = columns(truth.name, seed, 0, TRAIN)
    clean = record(truth, Effects(), seed, 0, TRAIN)
    change = read_forces(truth, train, own.stated.bore) - read_forces(truth, clean, {})
    change += clean.force - _as_stated(truth, own, clean)
    white = np.array([_noise(truth, k, own) for k in range(len(truth.joints))])
    noise = read_forces(truth, clean, {}) - clean.force
    A = np.vstack([(X / white[None, :, None]).reshape(-1, X.shape[2]), np.eye(X.shape[2])])
    b = np.r_[(change / white).ravel(), np.zeros(X.shape[2])]
    e = np.r_[(noise / white).ravel(), np.zeros(X.shape[2])]
    shift = np.linalg.lstsq(A, b, rcond=None)[0]
    left = b - A @ shift
    strength = float(left @ left)
    z = float(left @ (b + e)) / max(np.sqrt(strength), 1e-12)
    found: dict[str, Any] = {"witness_z": round(z, 2), "visible": bool(abs(z) > SEEN)}
    if estimate is None:
        return found | {"moves": None, "material": True}
    base, known = estimate.identifiability, list(estimate.problem.parameters.names)
    keys = ("m", "mc_x", "mc_y", "mc_z", "I_xx", "I_xy", "I_xz", "I_yy", "I_yz", "I_zz")
    psi = np.zeros(len(known))
    for name, step, amount in zip(names, steps, shift, strict=True):
        for key, value in zip([f"{name}.{key}" for key in keys] if len(step) > 1 else [name], step, strict=True):
            if key in known:
                psi[known.index(key)] += value * amount
    half = 1.96 * _stated(estimate)
    counted = [row["kind"] not in OTHER_FRICTION or not known[k].endswith(("_coulomb", "_viscous"))
               for k in base.basis]
    moved = np.max((np.abs(base.grouping @ psi) / half)[counted])
    forces = np.sqrt(np.mean((X @ shift) ** 2, axis=0))
    bounds = {each["of"]: each["bound"] for each in row["claims"] if each["about"] == "reading"}
    of = [bounds.get(truth.actuators[k], bounds.get(joint.name, np.inf)) for k, joint in enumerate(truth.joints)]
    in_forces = float(np.max(forces / of))
    return found | {"moves": round(float(max(moved, in_forces)), 2), "material": bool(max(moved, in_forces) > 1)}


def _noise(truth: Truth, k: int, own: Kind) -> float:
    if truth.joints[k].drive == "torque":
        return truth.torque_noise
    areas = next((each.areas for each in truth.cylinders if each.joint == k), (truth.motor, truth.motor))
    return float(truth.pressure_noise * np.hypot(*areas))


def _as_stated(truth: Truth, own: Kind, clean: Recording) -> Array:
    """Efforts where pins are as the file says and the first lifting joint is where its sensor says."""
    effects, k = own.effects, truth.first
    if not (own.stated.rod_pin or effects.zero or effects.angle_late):
        return clean.force
    cylinders = tuple(replace(each, rod_pin=tuple(np.array(each.rod_pin) + own.stated.rod_pin.get(each.name, (0, 0))))
                      for each in truth.cylinders)
    t, states = clean.t - effects.angle_late, (clean.q.copy(), clean.qd.copy(), clean.qdd.copy())
    for each in states:
        each[:, k] = np.interp(t, clean.t, each[:, k])
    states[0][:, k] += effects.zero
    stated = plant(replace(truth, cylinders=cylinders)).efforts(*states)[0]
    return clean.force + stated - plant(truth).efforts(clean.q, clean.qd, clean.qdd)[0]
