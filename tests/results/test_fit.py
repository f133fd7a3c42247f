"""Figures of a fit as Eq. 3.44 to 3.46 define them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.results.fit import Fit
from hydroopt.simulation.simulate import random_trajectory, simulate


def test_a_constant_error_lowers_vaf() -> None:
    signal = np.array([1.0, 3.0])  # about its mean: 1 + 1
    fit = Fit.of(np.array([10.0, 10.0]), signal, "N", free_run=True)
    assert (fit.rms, fit.vaf, fit.relative) == pytest.approx((10.0, 1 - 200 / 2, np.sqrt(200 / 10)))
    assert (fit.largest, fit.of_range) == pytest.approx((10.0, 5.0))
    assert np.isnan(Fit.of(signal, np.full(2, 7.0), "N").vaf)


@pytest.mark.slow
def test_an_offset_on_held_out_forces_shows() -> None:
    """With the mean of the error removed, VAF stayed near 100 % and no finding could speak of an offset."""
    model = Model(load_machine("ur10e"))
    train, held_out = (simulate(model, random_trajectory(model, duration=6.0, rate=15.0, seed=k), seed=k)
                       for k in (1, 2))
    name = "shoulder_pan.tau"
    off = {**held_out.channels, name: held_out.channels[name] + 3 * np.std(held_out.channels[name])}
    problem = identification_problem(model, [train], validation=[replace(held_out, channels=off)])
    estimate = identify(problem, intervals=False)
    fit = estimate.fit["validation"]
    parts = [one.vaf for channel, one in fit.items() if channel != "all"]
    assert fit["shoulder_pan_drive"].vaf < -5
    assert min(parts) < fit["all"].vaf < max(parts)
    said = {(each.kind, each.subject) for each in estimate.diagnostics}
    kinds = "validation forces off by a constant", "validation forces predicted worse than by zero"
    assert said & {(kind, ("shoulder_pan_drive",)) for kind in kinds}
