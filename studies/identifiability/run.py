"""Which of the CAT 215B's 82 parameters leave a trace, exactly, and which marks of Tables 13 and 14 cannot hold."""

from collections import Counter

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from hydroopt import Machine, Model, load_machine
from hydroopt.estimation.inference.identifiability import (
    COMBINATION,
    FULL,
    NONE,
    Identifiability,
    analyse,
    random_states,
    structural,
)
from hydroopt.plots.figures import BLUE, GREEN, GREY, INK, ORANGE
from hydroopt.spatial import inertia
from studies import show, thesis

MEANS = {thesis.FULL: (FULL,), thesis.COMBINATION: (COMBINATION,), thesis.NONE: (NONE, COMBINATION)}
"""What a mark can stand for: those left out of a combination are marked like those without a trace."""

TURNING = {"boom": np.radians(78.6) - np.arccos(0.625 / 2.000), "stick": np.arccos(0.720 / 2.444) - np.radians(10.3)}
"""Angles at which the boom's rod and the stick's barrel stop turning about their pins: there the triangle of Tables 3
and 11 has a right angle at the other pin."""

PLACES = dict(zip(thesis.SCALARS, ((0, 10), (3, 10), (6, 10), (0, 11), (3, 11), (6, 11), (1, 12), (4, 12), (1, 13),
                                   (4, 13), (2, 14), (5, 14)), strict=True))
"""Column and row of the parameters below the bodies' in Table 13."""

LETTER = {FULL: "alone", COMBINATION: "comb.", NONE: "none"}


def run() -> dict:
    """Counts of several geometries, conflicts with the thesis's marks, and proofs of the differences."""
    bundled = load_machine("cat215b")
    machines = {"planar": without_offset(bundled), "bundled": bundled, "twisted": twisted(bundled, 0)}
    spectra = {name: structural(Model(machine)) for name, machine in machines.items()}
    results: dict = {}
    for name, found in spectra.items():
        results |= {f"{name}_zero_columns": found.count(NONE), f"{name}_rank": found.rank,
                    f"{name}_individually": found.count(FULL), f"{name}_in_combination": found.count(COMBINATION)}
    # the singular values on both sides of the rank: the decision does not hang on the tolerance
    singular = spectra["bundled"].singular_values
    results |= {"parameters": len(spectra["bundled"].names),
                "last_kept_singular_value": float(singular[44] / singular[0]),
                "first_dropped_singular_value": float(singular[45] / singular[0]),
                "offset_column_error": offset_column_error(bundled)}

    model = Model(bundled)
    below = analyse(stacked(model, boom=(None, TURNING["boom"])), model.parameters.names)
    spectra["bundled, boom below its turning angle"] = below
    results |= {"turning_error": turning_error(model), "boom_below_turning_rank": below.rank}
    for name, found in (("bundled", spectra["bundled"]), ("boom_below_turning", below)):
        results[f"{name}_conflicts_with_table_13"] = len(conflicts(found, thesis.MARKS_13))
        results[f"{name}_conflicts_with_table_14"] = len(conflicts(found, thesis.MARKS_14))
    results |= surplus(model)
    results["rank_of_the_22"] = rank_of(Model(bundled, actuator_inertia=False), [*thesis.TABLE_15])
    results["twisted_rank_of_the_22"] = rank_of(Model(machines["twisted"], actuator_inertia=False), [*thesis.TABLE_15])
    others = [Model(twisted(bundled, seed)) for seed in range(1, 5)]
    ranks = {structural(each).rank for each in others}
    results |= {"other_twists_lowest_rank": min(ranks), "other_twists_highest_rank": max(ranks),
                "twisted_rank_of_the_51": max(rank_of(each, [*thesis.TABLE_14]) for each in others)}
    results["twisted_rank_boom_below"] = max(analyse(stacked(each, boom=(None, 0.0)), each.parameters.names).rank
                                             for each in others)
    results["one_skew_cylinder_rank"] = structural(Model(skew(bundled, "stick_cylinder"))).rank
    results["two_skew_cylinders_rank"] = structural(Model(skew(bundled, "stick_cylinder", "boom_cylinder"))).rank
    report(spectra["bundled"], below)
    draw_spectra(spectra)
    draw_marks(spectra["bundled"], below)
    return results


def conflicts(found: Identifiability, marks: dict[str, str]) -> list[str]:
    """Parameters whose mark says what the exact model does not."""
    return [name for name, category in zip(found.names, found.category, strict=True)
            if category not in MEANS[marks[name]]]


def stacked(model: Model, *, boom: tuple[float | None, float | None] = (None, None), seed: int = 0) -> np.ndarray:
    """The regressor (1200, 82) at 400 random joint states, the boom between these angles or its limits."""
    rng = np.random.default_rng(seed)
    q, qd, qdd = random_states(model, 400, rng)
    lower, upper = (limit if own is None else own
                    for own, limit in zip(boom, model.machine.link("boom").joint.range, strict=True))
    q[:, model.machine.joints.index("boom")] = rng.uniform(lower, upper, 400)
    return model.over(model.regressor, q, qd, qdd)[0].reshape(-1, len(model.parameters))


def rank_of(model: Model, names: list[str]) -> int:
    """Rank of the columns of these parameters."""
    return analyse(stacked(model)[:, model.parameters.select(names)], names).rank


SURPLUS = ("boom_cylinder.rod.mc_z", "stick.mc_z", "stick_cylinder.barrel.mc_z", "stick_cylinder.rod.mc_z",
           "boom_cylinder.barrel.m", "stick_cylinder.barrel.m", "stick_cylinder.barrel.I_xz")
"""Of the 51 parameters kept, those whose columns are sums of the others'."""


def surplus(model: Model) -> dict:
    """Rank of the 51 columns kept, and how exactly the surplus ones are sums of others, with what weights.

    The weights are found from columns and, apart from that, from the parallel-axis theorem: a first moment mc_z at the
    place (x, y) of a link is to that link -x in I_xz and -y in I_yz, and 2·d_2 in the moment about the swing axis; a
    mass at a pin of the cabin is its distance squared there; barrel and rod turn alike.
    """
    machine = model.machine
    boom, stick = machine.cylinders
    a, d = machine.link("boom").joint.a, 2 * machine.link("boom").joint.d
    predicted = {
        "boom_cylinder.rod.mc_z": {"boom.I_xz": -boom.rod.pin[0], "boom.I_yz": -boom.rod.pin[1], "swing.I_zz": d},
        "stick.mc_z": {"boom.I_xz": -a, "swing.I_zz": d},
        "stick_cylinder.barrel.mc_z": {"boom.I_xz": -stick.barrel.pin[0], "boom.I_yz": -stick.barrel.pin[1],
                                       "swing.I_zz": d},
        "stick_cylinder.rod.mc_z": {"boom.I_xz": -a, "stick.I_xz": -stick.rod.pin[0], "stick.I_yz": -stick.rod.pin[1],
                                    "swing.I_zz": d},
        "boom_cylinder.barrel.m": {"swing.I_zz": float(np.sum(np.square(boom.barrel.pin[:2])))},
        "stick_cylinder.barrel.I_xz": {"stick_cylinder.rod.I_xz": 1.0}}
    names = sorted(thesis.TABLE_14, key=SURPLUS.__contains__)
    places = model.parameters.select(names)
    found = analyse(stacked(model)[:, places], names)
    fresh = stacked(model, seed=1)[:, places]
    of_basis = fresh[:, list(found.basis)]
    off = max(np.linalg.norm(fresh[:, k] - of_basis @ found.grouping[:, k]) / np.linalg.norm(fresh[:, k])
              for k, name in enumerate(names) if name in SURPLUS)
    weight_errors = [abs(weight - found.grouping[found.basis.index(names.index(other)), names.index(name)])
                     for name, weights in predicted.items() for other, weight in weights.items()]
    return {"rank_of_the_51": found.rank, "surplus_in_basis": sum(names[k] in SURPLUS for k in found.basis),
            "surplus_column_error": float(off), "surplus_weight_error": float(max(weight_errors))}


def turning_error(model: Model) -> float:
    """Trace of a pin's friction, as a part of its joint's, at the angle at which the body should stop turning."""
    worst = 0.0
    for joint, name in (("boom", "boom_cylinder.n_rod"), ("stick", "stick_cylinder.n_barrel")):
        k = model.machine.joints.index(joint)
        q, qd = np.zeros((2, 3)), np.eye(3)[[k, k]]
        q[:, k] = TURNING[joint]
        K = model.over(model.regressor, q, qd, 0 * qd)[0][0, k]
        pin, own = K[model.parameters.select([name, f"{joint}.tau_coulomb"])]
        worst = max(worst, abs(pin / own))
    return float(worst)


def without_offset(machine: Machine) -> Machine:
    """The machine with the boom's offset d_2 and the lateral place of its barrel pin at zero."""
    data = machine.model_dump()
    for link in data["links"]:
        if link["name"] == "boom":
            link["joint"]["d"] = 0.0
    for cylinder in data["cylinders"]:
        if cylinder["name"] == "boom_cylinder":
            x, _, z = cylinder["barrel"]["pin"]
            cylinder["barrel"]["pin"] = (x, 0.0, z)
    return type(machine).model_validate(data)


def twisted(machine: Machine, seed: int) -> Machine:
    """The machine with every axis turned and every pin moved at random, by about 10 mrad and 10 mm."""
    rng = np.random.default_rng(seed)
    data = machine.model_dump()
    for link in data["links"]:
        for key in ("alpha", "beta", "d"):
            link["joint"][key] += rng.normal(0, 0.01)
    for cylinder in data["cylinders"]:
        for end in ("barrel", "rod"):
            cylinder[end]["pin"] = tuple((cylinder[end]["pin"] + rng.normal(0, 0.01, 3)).tolist())
    return type(machine).model_validate(data)


def skew(machine: Machine, *cylinders: str) -> Machine:
    """The machine with the rod pins of some cylinders 20 mm beside the plane that their barrel pins stand in."""
    data = machine.model_dump()
    for cylinder in data["cylinders"]:
        if cylinder["name"] in cylinders:
            x, y, z = cylinder["rod"]["pin"]
            cylinder["rod"]["pin"] = (x, y, z + 0.02)
    return type(machine).model_validate(data)


def offset_column_error(machine: Machine) -> float:
    """How exactly the swing's column of boom.mc_z is that of swing.I_zz times 2·d_2: the proof.

    A mass at height z beside the boom's plane is d_2 + z from the plane through the swing axis. Its moment of inertia
    about that axis holds (d_2 + z)², of which 2·d_2·z·m is linear in mc_z: constant, so that it adds to swing.I_zz.
    """
    model = Model(machine)
    q, qd, qdd = random_states(model, 500, np.random.default_rng(1))
    only_swing = np.zeros_like(qd)
    only_swing[:, 0] = 1.0
    K = model.over(model.regressor, q, qd * only_swing, qdd * only_swing)[0]
    column = {name: K[:, 0, model.parameters.index(name)] for name in ("boom.mc_z", "swing.I_zz")}
    d_2 = machine.link("boom").joint.d
    return float(np.max(np.abs(column["boom.mc_z"] - 2 * d_2 * column["swing.I_zz"])))


def report(found: Identifiability, below: Identifiability) -> None:
    """Print mark by mark: Table 13, Table 14, the exact model, and where they contradict each other."""
    exact, near = (dict(zip(each.names, each.category, strict=True)) for each in (found, below))

    def cell(name: str) -> str:
        ours = LETTER[exact[name]] + (f"/{LETTER[near[name]]}" if near[name] != exact[name] else "")
        wrong = near[name] not in MEANS[thesis.MARKS_13[name]]
        return f"{thesis.MARKS_13[name]}{thesis.MARKS_14[name]} {ours}{' !' if wrong else ''}"

    show.table("Table 13, Table 14, exact model (/ with the boom below its turning angle); ! contradicts Table 13",
               ("", *thesis.BODIES),
               [(element, *(cell(f"{body}.{element}") for body in thesis.BODIES)) for element in inertia.NAMES])
    show.table("Friction and offsets", ("parameter", "marks and exact model"),
               [(name, cell(name)) for name in thesis.SCALARS])
    counts = Counter((mark, exact[name]) for name, mark in thesis.MARKS_13.items())
    show.table("How many of each", ("Table 13", *LETTER.values()),
               [(mark, *(counts[mark, category] for category in LETTER)) for mark in MEANS])


def draw_spectra(spectra: dict[str, Identifiability]) -> None:
    """Singular values of the scaled regressors."""
    with show.look():
        figure = Figure(figsize=(8, 4), layout="constrained")
        ax = figure.subplots()
        for (name, found), colour, marker in zip(spectra.items(), (GREY, BLUE, ORANGE, GREEN), "osd.", strict=True):
            values = np.maximum(found.singular_values / found.singular_values[0], 1e-18)
            ax.semilogy(np.arange(1, len(values) + 1), values, color=colour, marker=marker, ms=3, lw=0.7,
                        label=f"{name}: rank {found.rank}")
        ax.axvline(51.5, color=INK, lw=0.8, ls=":")
        ax.annotate("51: Table 13", (51.5, 1e-8), xytext=(5, 0), textcoords="offset points")
        ax.set(xlabel="singular value, by size", ylabel="singular value / the largest",
               title="regressor of the complete model, columns of unit length", ylim=(1e-18, 3))
        ax.yaxis.set_major_formatter("{x:.0e}")
        ax.legend(loc="lower left")
    show.save(figure, "identifiability", "singular_values")


def draw_marks(found: Identifiability, below: Identifiability) -> None:
    """Table 13 with its marks on the colour of what the exact model says."""
    exact, near = (dict(zip(each.names, each.category, strict=True)) for each in (found, below))
    colours = {FULL: GREEN, COMBINATION: BLUE, NONE: GREY}
    with show.look():
        figure = Figure(figsize=(8.5, 6), layout="constrained")
        ax = figure.subplots()
        for name, mark in thesis.MARKS_13.items():
            owner, _, element = name.rpartition(".")
            x, y = PLACES[name] if name in PLACES else (thesis.BODIES.index(owner), inertia.NAMES.index(element))
            wrong = exact[name] not in MEANS[mark]
            by_range = wrong and near[name] in MEANS[mark]
            ax.add_patch(Rectangle((x, y), 1, 1, color=colours[exact[name]], alpha=0.3, lw=0))
            ax.text(x + 0.5, y + 0.52, mark, ha="center", va="center", fontsize=11,
                    color=ORANGE if wrong and not by_range else INK, weight="bold" if wrong else "normal")
            if wrong:
                ax.add_patch(Rectangle((x + 0.04, y + 0.06), 0.92, 0.88, fill=False, lw=1.2,
                                       edgecolor=INK if by_range else ORANGE, ls=":" if by_range else "-"))
        ax.set_xticks(np.arange(len(thesis.BODIES)) + 0.5, [body.replace("_cylinder.", "\n") for body in thesis.BODIES])
        ax.set_yticks(np.arange(15) + 0.5, [*inertia.NAMES, "joint friction", "offset", "cylinder friction",
                                            "barrel pin friction", "rod pin friction"])
        ax.set(xlim=(0, len(thesis.BODIES)), ylim=(15, 0), title="Marks of Table 13 on what the exact model says")
        ax.grid(visible=False)
        ax.tick_params(length=0)
        ax.xaxis.tick_top()
        said = ((FULL, "identifiable alone"), (COMBINATION, "in combination"), (NONE, "no trace"))
        figure.legend(loc="outside lower center", ncols=5, handles=[
            *(Patch(color=colours[category], alpha=0.3, lw=0, label=label) for category, label in said),
            Patch(fill=False, edgecolor=ORANGE, lw=1.2, label="cannot hold"),
            Patch(fill=False, edgecolor=INK, lw=1.2, ls=":", label="holds while the boom's angle stays below 6.8°")])
    show.save(figure, "identifiability", "marks")
