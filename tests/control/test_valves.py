"""The valve turned round: commands that open its edges so far, and late commands in force when they should be."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from hydroopt.control.closed_loop import CommandDelay
from hydroopt.control.valve_inversion import command
from hydroopt.machine.valves import Valve
from hydroopt.model.hydraulics import openings, spool_position

VALVES = {
    "overlapped": {"dead_band": 0.05, "overlap": 0.03},
    "in volts, turned round": {"command": "V", "neutral": 5.0, "full": 1.0, "dead_band": 0.4, "dead_band_reverse": 0.7},
    "without any dead zone": {}}


@pytest.mark.parametrize("kind", VALVES)
def test_edges_open_as_far_as_the_command_was_made_for(kind: str) -> None:
    valve = Valve.model_validate({"rated_flow": 1e-3, "rated_drop": 35e5} | VALVES[kind])

    def value(key: str) -> float:
        return float(getattr(valve, key))

    share = ca.SX.sym("share")
    told = command(valve, share, value)
    edges = openings(valve, spool_position(valve, told, value), value)
    function = ca.Function("edges", [share], [told, edges.pa, edges.at])
    wide = np.concatenate([-np.linspace(0.02, 0.98, 60), np.linspace(0.02, 0.98, 60)])
    told_values, pa, at = (np.array(part).ravel() for part in function.map(len(wide))(wide.reshape(1, -1)))
    # the rounded corner of the dead band's other side is still felt, by w²/(4·x) at a distance x from it
    assert_allclose(np.where(wide > 0, pa, at), np.abs(wide), atol=2e-4 if valve.dead_band else 1.5e-3)
    assert np.all(np.where(wide > 0, at, pa) < valve.rounding)
    assert np.all((told_values > valve.neutral) == (wide * valve.span > 0))
    assert float(function(0.0)[0]) == valve.neutral


def test_commands_act_when_their_delay_is_over() -> None:
    """Against the held signal itself, looked up at every time less the delay."""
    period, delays = 0.02, np.array([0.0, 0.02, 0.05, 0.013])
    rng = np.random.default_rng(4)
    sent = rng.standard_normal((12, 4))
    delay, t, pieces = CommandDelay(delays, period, sent[0]), 0.0, []
    for k in range(len(sent)):
        for length, held in delay.push(sent[k]):
            pieces.append((t + length / 2, held))
            t += length
    assert t == pytest.approx(len(sent) * period)
    for middle, held in pieces:
        index = np.maximum(np.floor((middle - delays) / period).astype(int), 0)
        assert_allclose(held, sent[index, range(4)])
