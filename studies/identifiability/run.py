"""Which of the CAT 215B's 82 parameters leave a trace, exactly: Table 13 against the exact geometry."""

import numpy as np

from hydroopt import Model, load_machine
from hydroopt.identifiability import FULL, random_states, structural


def run() -> dict:
    """Counts with d_2 = 0 (the planar machine) and with the bundled d_2 = −0.11 m, and the proof of the difference."""
    bundled = load_machine("cat215b")
    planar = without_offset(bundled)
    results: dict = {}
    for name, machine in (("planar", planar), ("bundled", bundled)):
        found = structural(Model(machine))
        results |= {f"{name}_parameters": len(found.names), f"{name}_zero_columns": found.count("none"),
                    f"{name}_rank": found.rank, f"{name}_individually": found.count(FULL),
                    f"{name}_in_combination": found.count("combination")}
    # the singular values on both sides of the rank: the decision does not hang on the tolerance
    singular = structural(Model(bundled)).singular_values
    results |= {"last_kept_singular_value": float(singular[44] / singular[0]),
                "first_dropped_singular_value": float(singular[45] / singular[0])}
    results["offset_column_error"] = offset_column_error(bundled)
    return results


def without_offset(machine):
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


def offset_column_error(machine) -> float:
    """How exactly the swing's column of boom.mc_z is that of swing.I_zz times 2·d_2: the proof.

    A mass at height z beside the boom's plane is d_2 + z from the plane through the swing axis. Its moment of inertia
    about that axis holds (d_2 + z)², of which 2·d_2·z·m is linear in mc_z: constant, so that it adds to swing.I_zz.
    """
    model = Model(machine)
    q, qd, qdd = random_states(model, 500, np.random.default_rng(1))
    K = model.over(model.regressor, q, qd, qdd)[0]
    column = {name: K[:, 0, model.parameters.index(name)] for name in ("boom.mc_z", "swing.I_zz")}
    only_swing = np.zeros_like(qd)
    only_swing[:, 0] = 1.0
    K = model.over(model.regressor, q, qd * only_swing, qdd * only_swing)[0]
    column = {name: K[:, 0, model.parameters.index(name)] for name in column}
    d_2 = machine.link("boom").joint.d
    return float(np.max(np.abs(column["boom.mc_z"] - 2 * d_2 * column["swing.I_zz"])))
