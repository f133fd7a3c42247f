"""Generated machines, compiled once for all tests of a process."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import pytest

from fixtures import library
from fixtures.library import Library


@pytest.fixture(scope="session")
def libraries(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Library]:
    """The library of a subject in ``double`` or ``float``, by optimisation level and routines."""
    home = tmp_path_factory.mktemp("libraries")

    @cache
    def get(subject: str, real: str, level: str, *routines: str) -> Library:
        place = "_".join((*subject.split(), real, *routines))
        return Library(library.subject(subject, real, *routines), home / place, level)

    return get
