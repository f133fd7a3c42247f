"""The card of an answer is short, is data in JSON, and never calls a suspect answer usable."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from hydroopt.results.json_file import validated
from hydroopt.results.readable import readable
from hydroopt.results.status import Status
from hydroopt.results.verdict import LINES, THRESHOLDS, Action, Claim, NextStep, Purpose, Usable, Verdict, judged

USES = (judged(Purpose.FORCE, "boom_cylinder", 2600.0, "N", 0.025, condition="on 1 held-out log"),
        judged(Purpose.FORCE, "stick_cylinder", 9000.0, "N", 0.16, condition="on 1 held-out log"),
        judged(Purpose.MASS, "boom.m", 40.0, "kg", 0.03),
        judged(Purpose.WEIGHING, "", 12.0, "kg", 0.01, untested="no log was held out"))
VERDICT = Verdict("cat215b: identification by sdp", Status.OK, "", USES,
                  (NextStep(Action.DRIVE, "Reverse the stick more often."),))


def test_a_figure_counts_up_to_its_threshold() -> None:
    limit = THRESHOLDS[Purpose.FORCE].part
    at, beyond = (judged(Purpose.FORCE, "boom", 1.0, "N", part) for part in (limit, 1.001 * limit))
    assert (at.usable, beyond.usable) == (Usable.YES, Usable.NO)
    assert "of the force's range" in beyond.reason


def test_every_threshold_has_a_reason() -> None:
    assert all(limit.part > 0 and limit.reason.endswith(".") for limit in THRESHOLDS.values())


def test_a_figure_of_unknown_part_is_not_tested() -> None:
    assert judged(Purpose.FORCE, "boom", 1.0, "N", float("nan")).usable is Usable.UNTESTED
    assert judged(Purpose.FORCE, "boom", float("inf"), "N", float("inf")).usable is Usable.UNTESTED


@pytest.mark.parametrize("status", [Status.SUSPECT, Status.FAILED])
def test_nothing_of_an_answer_that_is_not_ok_is_usable(status: Status) -> None:
    verdict = replace(VERDICT, status=status, cause="boom.q has the wrong sign.")
    assert {claim.usable for claim in verdict.claims} == {Usable.NO, Usable.UNTESTED}
    assert not any(line.startswith("  usable") for line in verdict.card().splitlines())
    assert verdict.card().startswith(f"cat215b: identification by sdp: {status}. boom.q has the wrong sign.")
    assert not verdict.usable(Purpose.FORCE)


def test_usable_for_a_part_and_for_all() -> None:
    assert VERDICT.usable(Purpose.FORCE, "boom_cylinder")
    assert not VERDICT.usable(Purpose.FORCE)
    assert not VERDICT.usable(Purpose.LOAD)


def test_figures_stand_by_their_reason() -> None:
    claims = (Claim(Purpose.MASS, "swing.m", Usable.NO, reason="not identified by any motion"),
            judged(Purpose.MASS, "boom.m", 400.0, "kg", 0.2, condition="95 %"),
            Claim(Purpose.MASS, "base.m", Usable.NO, reason="not identified by any motion"))
    card = " ".join(Verdict("crane: check", Status.OK, "", claims).card().split())
    assert "boom.m ±400 kg (20 %): more than 10 % of its value; swing.m, base.m: not identified by any motion" in card


def test_json_says_the_same() -> None:
    bounds = [claim.as_dict() for claim in VERDICT.claims if claim.bound is not None]
    text, claims = json.dumps(VERDICT.as_dict(), allow_nan=False), json.loads(json.dumps(bounds, allow_nan=False))
    said = json.loads(text)
    assert validated(Verdict, said | {"claims": [*claims, *said["unbounded"]]}) == VERDICT


@pytest.mark.parametrize("count", [1, 9, 60])
def test_the_card_is_short_whatever_there_is_to_say(count: int) -> None:
    name, sentence = "a_rather_long_name_of_a_cylinder", "This sentence says at some length what to do next. " * 3
    claims = tuple(judged(purpose, f"{name}_{k}", 1.0, "kg", part, condition=sentence) for k in range(count)
                 for purpose in THRESHOLDS for part in (0.0, 1.0))
    card = Verdict(name, Status.OK, sentence, claims, (NextStep(Action.CHECK, sentence),) * count).card()
    assert len(card.splitlines()) <= LINES
    assert "  next        This sentence says" in card


def test_quantities_in_the_units_of_the_shop() -> None:
    assert [readable(*each) for each in ((0.0, "N"), (990.0, "N"), (-2500.0, "N*m"), (1.5, "kg*m^2"), (2e5, "Pa"))] == [
        "0 N", "990 N", "-2.5 kN·m", "1.5 kg·m²", "2.0 bar"]
