"""What the forces of a machine with a linkage tell of its bodies."""

import numpy as np

from fixtures.loops import excavator
from hydroopt.estimation.inference import identifiability
from hydroopt.model.model import Model
from oracles.subjects import states


def test_as_many_base_parameters_as_random_states_show():
    model = Model(excavator())
    (K,) = model.over(model.regressor, *states(model.machine, np.random.default_rng(50), 600))
    K = K.reshape(-1, K.shape[2])
    size = np.linalg.norm(K, axis=0)
    seen = size > 1e-9 * size.max()
    values = np.linalg.svd(K[:, seen] / size[seen], compute_uv=False)
    rank = int(np.sum(values > 1e-9 * values[0]))
    assert values[rank] < 1e-13 * values[0]  # nothing in between
    found = identifiability.structural(model)
    assert (found.rank, rank, found.count("none")) == (71, 71, int(np.sum(~seen)))
    categories = dict(zip(model.parameters.names, found.category, strict=True))
    assert categories["coupler.mc_y"] == "full"
    assert categories["rocker.mc_x"] == categories["coupler.m"] == "combination"
