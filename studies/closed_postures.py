"""Postures of a stage in which a calibrator closes the chain: at random, or along a sweep, as the thesis has them."""

from __future__ import annotations

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.machine.calibration_chain import Stage
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from hydroopt.spatial.inertia import Array


def random_postures(model: KinematicModel, stage: Stage, count: int, *, geometry: Array, fixture: postures.Held,
                    locked: dict[str, float] | None = None, seed: int = 0) -> Array:
    """Closed postures (count, n) of a stage, spread over the limits of moving and measured joints.

    Args:
        model: geometry; `geometry` (p,) its values.
        stage: which joints move and where the others are locked.
        count: how many.
        fixture: what holds the tip.
        locked: angles [rad] other than the stage's.
        seed: of the random generator.

    Raises:
        ProblemError: hardly any posture closes within the limits.
    """
    turning = postures.sensed_joints(model)
    found, tried = postures.closed_postures(
        model, count, np.random.default_rng(seed), geometry=geometry, turning=turning, held=fixture,
        within_limits=[*turning, *(model.joints.index(name) for name in stage.moves)],
        locked=dict(stage.locked) | (locked or {}), batch=2 * count,
        give_up=lambda found, tried: tried >= 100 * count + 1000)
    if len(found) < count:
        raise ProblemError(f"only {len(found)} of {tried} postures close within the joints' limits",
                           where=f"stage '{stage.name}'",
                           remedy="move the fixture, widen the calibrator's limits or lock the joints elsewhere")
    return found


def sweep(model: KinematicModel, stage: Stage, path: Array, *, geometry: Array, fixture: postures.Held,
          locked: dict[str, float] | None = None) -> Array:
    """Closed postures (N, n) along a path (N, number of moving joints) [rad]; the calibrator follows.

    Raises:
        ProblemError: the chain opens on the way.
    """
    low, high = model.ranges.T
    moving, free = [model.joints.index(name) for name in stage.moves], postures.sensed_joints(model)
    q = np.clip(np.zeros(len(low)), low, high)
    for name, angle in (dict(stage.locked) | (locked or {})).items():
        q[model.joints.index(name)] = angle
    q[free] = (low + high)[free] / 2
    found = []
    for k, target in enumerate(np.atleast_2d(path)):
        q = q.copy()
        q[moving] = target
        closed, good = postures.close(model, geometry, q[None], free, fixture)
        if not good[0]:
            raise ProblemError(f"the chain opens at step {k + 1} of the sweep", where=f"stage '{stage.name}'",
                               remedy="shorten the sweep or move the fixture")
        q = closed[0]
        found.append(q)
    return np.array(found)
