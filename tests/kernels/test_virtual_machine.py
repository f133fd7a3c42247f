"""Functions that are simplified once and kept."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from hydroopt.kernels import virtual_machine as subject
from hydroopt.kernels.expression_graph import program


def chained(terms: int) -> ca.Function:
    x = ca.SX.sym("x", terms)
    return ca.Function("chained", [x], [ca.vertcat(sum(ca.sin(x[k]) * x[k] for k in range(terms)), 0, x[0])])


def files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.function"))


def test_what_is_kept_is_what_would_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HYDROOPT_CACHE", str(tmp_path / "cache"))
    function = chained(100)
    made = subject.simplified(function)
    assert made.serialize() == program(function).function().serialize()
    kept, = files(tmp_path / "cache")
    monkeypatch.setattr(subject, "program", None)  # nothing is simplified again
    assert subject.simplified(function).serialize() == made.serialize()
    monkeypatch.undo()
    monkeypatch.setenv("HYDROOPT_CACHE", str(tmp_path / "cache"))
    kept.write_bytes(kept.read_bytes()[:-1])  # damaged
    assert subject.simplified(function).serialize() == made.serialize()
    x = np.linspace(-1, 1, 100)
    np.testing.assert_allclose(subject.simplified(function)(x).full(), function(x).full(), rtol=1e-13)
    subject.simplified(chained(101))
    assert len(files(tmp_path / "cache")) == 2


def test_where_nothing_can_be_kept_functions_are_simplified_all_the_same(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "file"
    place.write_text("")
    monkeypatch.setenv("HYDROOPT_CACHE", str(place))
    assert subject.simplified(chained(100)).n_instructions() < chained(100).n_instructions() + 3
