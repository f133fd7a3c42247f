"""The ways in which compiled kernels may have been made."""

from __future__ import annotations

import platform
from collections.abc import Iterator

import pytest

from hydroopt.kernels import compiler, shared_library

FILES = ("wide_windows.c",)


@pytest.fixture(params=[None, "", "-mno-avx512f", "-mno-avx"])
def vectors(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No compiler, and one that makes code for the longest vectors, for those of four and of two numbers."""
    if request.param and platform.machine() != "x86_64":
        pytest.skip("an option of other processors")
    kept = compiler.compiler, shared_library.of_file
    for each in kept:
        each.cache_clear()
    if request.param is None:
        monkeypatch.setattr(shared_library, "compiler", lambda: None)
    elif request.param:
        monkeypatch.setenv("CC", f"cc {request.param}")
    made = [shared_library.of_file(name, name, "this test fails") is not None for name in FILES]
    assert made == [request.param is not None] * len(FILES)
    yield
    for each in kept:
        each.cache_clear()
