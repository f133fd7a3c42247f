"""Tables 13 to 17 of the thesis by parameter name, rows of inertia in the order of Eq. 4.12 (see THESIS_NOTES)."""

from collections.abc import Iterable

import numpy as np

from hydroopt import IdentificationProblem
from hydroopt.estimation.dynamic.regressor_qr import compress
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.inference.least_squares import truncated_svd
from hydroopt.spatial import inertia

FULL, COMBINATION, NONE = "‡", "†", "*"
"""Marks: identified alone, stands for a linear combination, not identified (no trace, or left out of a combination)."""

BODIES = ("swing", "boom_cylinder.barrel", "boom_cylinder.rod", "boom", "stick_cylinder.barrel", "stick_cylinder.rod",
          "stick")
"""Columns of Tables 13, 14 and 16."""

SCALARS = ("swing_motor.tau_coulomb", "boom.tau_coulomb", "stick.tau_coulomb", "swing_motor.tau_offset",
           "boom_cylinder.f_offset", "stick_cylinder.f_offset", "boom_cylinder.f_coulomb", "stick_cylinder.f_coulomb",
           "boom_cylinder.n_barrel", "stick_cylinder.n_barrel", "boom_cylinder.n_rod", "stick_cylinder.n_rod")
"""Entries of the rows τ_fric, offset, f_fric, n_c and n_p, from left to right."""

REDUCED_SCALARS = SCALARS[:6]


def _named(text: str, columns: tuple[str, ...], scalars: tuple[str, ...]) -> dict[str, str]:
    rows = [line.split() for line in text.strip().splitlines()]
    table = {f"{body}.{element}": cell for element, row in zip(inertia.NAMES, rows, strict=False)
             for body, cell in zip(columns, row, strict=True)}
    return table | dict(zip(scalars, (cell for row in rows[len(inertia.NAMES):] for cell in row), strict=True))


def _values(text: str, columns: tuple[str, ...], scalars: tuple[str, ...]) -> dict[str, tuple[float, ...]]:
    """Numbers of a table; what was not identified ("*") is left out."""
    return {name: tuple(float(value) for value in cell.split("/"))
            for name, cell in _named(text, columns, scalars).items() if cell != NONE}


MARKS_13 = _named("""
    * ‡ † * ‡ † *
    * ‡ ‡ † ‡ ‡ †
    * ‡ ‡ † ‡ ‡ †
    * * ‡ * ‡ ‡ ‡
    * * † * * * †
    * * † † † * †
    * † * ‡ † † ‡
    * * * * † * *
    * * † ‡ † * ‡
    † * † * † * †
    ‡ † ‡
    ‡ ‡ ‡
    ‡ ‡
    † ‡
    * ‡
    """, BODIES, SCALARS)
"""31 *, 24 †, 27 ‡."""

MARKS_14 = _named("""
    * ‡ ‡ * ‡ ‡ *
    * ‡ ‡ ‡ ‡ ‡ ‡
    * ‡ ‡ ‡ ‡ ‡ ‡
    * * ‡ * ‡ ‡ ‡
    * * ‡ * * * ‡
    * * ‡ ‡ ‡ * ‡
    * ‡ * ‡ † ‡ ‡
    * * * * ‡ * *
    * * ‡ ‡ ‡ * ‡
    ‡ * ‡ * ‡ * ‡
    ‡ ‡ ‡
    ‡ ‡ ‡
    ‡ ‡
    ‡ ‡
    * ‡
    """, BODIES, SCALARS)

TABLE_14 = _values("""
    * 5.4e5/-4.1e6  1.3e5/-2.1e6  *            3600/-47900  -13700/2.5e5 *
    * -28000/-5.1e5 -74000/9.3e5  -3.9e5/3.2e6 -1200/-16100 1500/15700   -7500/1.5e5
    * -3.8e5/2.1e6  -7700/-3.8e5  2.0e5/-2.7e5 80/5500      38/-520      -5600/1.0e5
    * *             -4.6e5/3.4e6  *            -1800/-46700 400/25100    1200/9200
    * *             3.9e5/-5.6e6  *            *            *            -4200/-8500
    * *             -2.9e5/2.0e6  -1.9e5/2.1e6 6200/-1.3e5  *            -3400/80700
    * -1.0e5/-5.0e5 *             -6.0e5/-5.7e6 0/0         -1900/29000  -900/-10200
    * *             *             *            4800/4.1e5   *            *
    * *             -38900/-5.1e5 5.0e5/-4.2e6 4200/-38000  *            600/-16700
    -77600/4.1e6 *  1.4e5/-1.2e6  *            -7600/-61000 *            7800/-1.3e5
    -198/5520 38100/-5.9e5 150/5400
    -322/1140 9.8e6/-4.2e7 -900/-12900
    45300/-9.4e5 -800/-17300
    -72800/1.3e6 36/-24800
    * 540/8250
    """, BODIES, SCALARS)
"""Complete model, transducers to ±5 psi / ±25 psi; SI."""

TABLE_15 = _values("""
    * * 1400/380
    * 1900/28400 540/200
    * 160/1400 24/440
    * * -34/840
    * * -540/3100
    * 310/3600 -120/800
    * -70/40 -140/1900
    * * *
    * 220/-3900 -50/500
    16500/21400 700/28300 630/810
    -13/1100 9/100 19/-100
    17/450 -7600/-3.3e5 -114/-6500
    """, ("swing", "boom", "stick"), REDUCED_SCALARS)
"""Reduced model, transducers to ±5 psi / ±25 psi; SI."""

TABLE_16 = _values("""
    *      5.2e5  -6.5e5 *      3840   -60200 *
    *      -2.1e6 2.1e6  1.5e6  3300   -3300  -35100
    *      88400  41000  -7.7e5 10300  -6900  -24800
    *      *      -1.1e6 *      2100   22700  430
    *      *      5.2e5  *      *      *      -4100
    *      *      -2.3e6 -2.7e6 5800   *      -10900
    *      -1.1e6 *      -7.8e5 0      23500  -12100
    *      *      *      *      -2.5e5 *      *
    *      *      -8.8e5 9.4e5  -8300  *      -11100
    -2.6e6 *      -4.0e6 *      25500  *      29500
    14700 -17700 3900
    -1300 -5.4e6 -2900
    -2.1e5 -31500
    1.5e5 -10600
    * 22000
    """, BODIES, SCALARS)
"""Complete model, real machine; SI."""

TABLE_17 = _values("""
    * * 6870
    * -22200 600
    * -2950 -278
    * * -285
    * * -15200
    * -61100 -8600
    * -45500 -1600
    * * *
    * -14900 -4100
    -146000 -151000 -490
    13200 2030 530
    980 -95700 180
    """, ("swing", "boom", "stick"), REDUCED_SCALARS)
"""Reduced model, real machine; SI."""

RMS = {"complete": (3720.0, 5860.0, 8700.0), "reduced": (4720.0, 5500.0, 11900.0),
       "nominal": (12200.0, 39200.0, 14600.0)}
"""Errors of predicted forces of the machine's run that was not used (Section 4.6): swing [N·m], boom [N], stick [N]."""

SENSOR_ERROR = (1400.0, 5700.0, 4200.0)
"""Largest error of the measured force at ±25 psi (Section 4.4.3), as in `RMS`."""


def identified(problem: IdentificationProblem, names: Iterable[str]) -> np.ndarray:
    """ψ (p,) as the thesis finds it: truncated singular values of some columns of K (Eq. 4.60), the others at zero.

    Rows are not weighted, as in Eq. 4.58, so that newtons count as much as newton metres.
    """
    R, r, _ = compress(problem.experiments).weighted(np.ones(len(problem.force_std)))
    columns = problem.parameters.select(list(names))
    psi = np.zeros(len(problem.parameters))
    psi[columns] = truncated_svd(R[:, columns], r, RANK_TOLERANCE)[0]
    return psi
