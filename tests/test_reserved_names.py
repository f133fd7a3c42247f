"""No name has a meaning of its own: what is tried at random of the study's names, and those that had one."""

from __future__ import annotations

import random
from itertools import islice
from typing import Any

import pytest

from studies.first_contact import names

SOME = random.Random(47).sample([(role, word) for role in names.ROLES for word in names.WORDS], 6)


@pytest.fixture(scope="module")
def expected() -> dict[str, Any]:
    """What hydroopt answers with neutral names, up to converted files."""
    return dict(islice(names.answers(names.NEUTRAL, thorough=False), 5))


@pytest.mark.parametrize(("role", "word"), [("link", "chassis"), ("link", "ground"), ("cylinder", "pump"), *SOME])
def test_a_name_is_a_name_or_is_refused(role: str, word: str, expected: dict[str, Any]) -> None:
    assert names.tried(role, word, expected, thorough=False).partition(":")[0] in ("same", "refused")


@pytest.mark.parametrize(("role", "word", "why"), [
    ("link", "base", "is the chassis"), ("cylinder", "all", "is all actuators together"),
    ("sensor", "a-b", "at most 63 letters, digits and _, a letter first"), ("machine", "y" * 64, "at most 63 letters")])
def test_a_name_that_cannot_be_is_refused_with_the_reason(role: str, word: str, why: str) -> None:
    assert why in names.tried(role, word, {"read": True}, thorough=False)
