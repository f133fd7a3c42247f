"""A terminal shows findings of the data apart from properties of the machine, and folds groups into one line."""

from __future__ import annotations

from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.summary import DATA, MACHINE, OF_MACHINE, summary
from hydroopt.results.wording import CONTRADICTIONS, Kind


def test_what_contradicts_an_answer_is_a_finding_of_data() -> None:
    assert not OF_MACHINE & CONTRADICTIONS


def test_groups_that_are_not_separable_are_one_line_with_their_number() -> None:
    groups = [Diagnostic(Kind.CONFOUNDED, names, {"effects": "gravity", "variance_inflation": 200.0, "decades": 2})
              for names in (("boom.m", "stick.m"), ("boom.mc_x", "boom.mc_y", "stick.mc_x"))]
    told = summary([*groups, Diagnostic(Kind.NO_VALIDATION)])
    assert list(told) == [DATA, MACHINE]
    (line,) = told[MACHINE]
    assert line.startswith("5 parameters in 2 groups are not separable in this motion")
    assert "Reverse the motion" in line


def test_a_single_group_is_named() -> None:
    group = Diagnostic(Kind.CONFOUNDED, ("boom.m", "stick.m"),
                       {"effects": "gravity", "variance_inflation": 200.0, "decades": 2})
    assert "boom.m, stick.m" in summary([group])[MACHINE][0]
