"""Tables of parameters and of the fit as pages show them, with a small figure of each change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from markupsafe import Markup

from hydroopt.report.numbers import NONE, Row, percent, plain, quantity
from hydroopt.report.panels import Units, shown
from hydroopt.results.fit import Fit
from hydroopt.results.parameter_table import ParameterRow, ParameterTable

REACH = 5.0
"""Standard deviations up to which the figure shows changes; what lies beyond is drawn at its edge."""
WIDE, TALL, ROUND = 150, 16, 3.2
"""Measures of the figure, and the radius of the estimate's dot."""
PRIOR = 1.96
"""Half of a prior's 95 % interval in standard deviations."""


class Parameter(NamedTuple):
    """One line of a table of parameters; `alone`: a value without an interval; `beside`: it lies outside of it."""

    name: str
    element: str
    unit: str
    numbers: Row
    prior: str
    from_data: str
    bound: str
    identifiability: str
    alone: bool
    beside: bool
    figure: Markup


def parameter(one: ParameterRow, units: Units) -> Parameter:
    """A parameter in print."""
    unit, factor = shown(one.unit, units)
    value, std, nominal, prior, low, high = (math.nan if x is None else factor * x for x in (
        one.value, one.std, one.nominal, one.prior_std, *(one.ci95 or (None, None))))
    known = one.information_from_data
    return Parameter(one.name, one.name.rpartition(".")[2], unit, quantity(value, std, (low, high), nominal),
                     plain(prior, 2), NONE if known is None else plain(100 * known, 2), one.bound or "",
                     one.identifiability, one.ci95 is None and one.value is not None, value < low or value > high,
                     interval(one))


def by_owner(table: ParameterTable, units: Units) -> dict[str, list[Parameter]]:
    """Parameters by the part that they belong to."""
    groups: dict[str, list[Parameter]] = {}
    for one in table.rows:
        groups.setdefault(one.name.rpartition(".")[0], []).append(parameter(one, units))
    return groups


class FitCells(NamedTuple):
    """RMS error, VAF and relative error [%], those of free runs, and whether the mean would have predicted better."""

    rms: str = NONE
    vaf: str = NONE
    relative: str = NONE
    largest: str = NONE
    of_range: str = NONE
    bad: bool = False


def fit_cells(fit: Fit | None, units: Units, digits: int = 4) -> FitCells:
    """A fit in print; dashes where there is none."""
    if fit is None:
        return FitCells()
    _, factor = shown(fit.unit, units)
    largest, of_range = (np.nan if x is None else x for x in (fit.largest, fit.of_range))
    return FitCells(plain(factor * fit.rms, digits), percent(fit.vaf), percent(fit.relative),
                    plain(factor * largest, digits), percent(of_range), fit.vaf < 0)


def fit_rows(fit: Mapping[str, Mapping[str, Fit]], units: Units,
             digits: int = 4) -> list[tuple[str, str, list[FitCells]]]:
    """Channel, unit, and the cells of training and validation; of a single channel, not all together."""
    sets = [fit.get(name, {}) for name in ("train", "validation")]
    channels = {channel: one.unit for table in sets for channel, one in table.items()
                if channel != "all" or len(table) > 2}
    return [(channel, shown(unit, units)[0], [fit_cells(table.get(channel), units, digits) for table in sets])
            for channel, unit in channels.items()]


def interval(one: ParameterRow) -> Markup:
    """The change against the nominal value with its interval; a hollow dot is identifiable only with others or a prior.

    In standard deviations of the prior, or of the estimate where it has no prior; empty without an interval.
    """
    size = one.prior_std or one.std
    if one.value is None or one.nominal is None or one.ci95 is None or not size:
        return Markup("")
    change, low, high = ((x - one.nominal) / size for x in (one.value, *one.ci95))
    of = "prior standard deviations" if one.prior_std else "standard deviations of its own, without a prior"
    said = f"changed by {plain(change, 2)}, 95 % interval {plain(low, 2)} to {plain(high, 2)} {of}"
    return _drawn(said, change, low, high, prior=bool(one.prior_std), together=one.identifiability != "full")


def spread(value: float, ci95: tuple[float, float], reach: float, unit: str) -> Markup:
    """A value [`unit`] with its 95 % interval about zero, on an axis to ±`reach`; empty without an interval."""
    if not reach > 0 or not all(map(math.isfinite, (value, *ci95))):
        return Markup("")
    said = f"{plain(value, 3)}, 95 % interval {plain(ci95[0], 3)} to {plain(ci95[1], 3)} {unit}"
    return _drawn(said, *(REACH * each / reach for each in (value, *ci95)))


def _drawn(said: str, value: float, low: float, high: float, *, prior: bool = False, together: bool = False) -> Markup:
    """A value with its interval on an axis to ±`REACH`; an arrow where it lies beyond, a hollow dot if `together`."""
    (x, a, b, left), middle = map(_place, (value, low, high, -PRIOR)), TALL // 2
    look = f'class="value{" together" if together else ""}"'
    box = f'<rect class="prior" x="{left:.1f}" y="2" width="{PRIOR * WIDE / REACH:.1f}" height="{TALL - 4}"/>'
    dot = (f'<circle {look} cx="{x:.1f}" cy="{middle}" r="{ROUND}"/>' if abs(value) <= REACH else
           f'<path {look} d="M{x:.1f} {middle - 4}v8l{5 if value > 0 else -5} -4z"/>')
    return Markup(f'<svg class="interval" viewBox="0 0 {WIDE} {TALL}" role="img" aria-label="{said}">{box * prior}'
                  f'<line class="zero" x1="{WIDE // 2}" x2="{WIDE // 2}" y1="0" y2="{TALL}"/>'
                  f'<line class="bar" x1="{a:.1f}" x2="{b:.1f}" y1="{middle}" y2="{middle}"/>{dot}</svg>')


def _place(value: float) -> float:
    return float(WIDE / 2 + min(REACH, max(-REACH, value)) * (WIDE - 12) / (2 * REACH))
