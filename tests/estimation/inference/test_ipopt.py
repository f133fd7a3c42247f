"""IPOPT as hydroopt calls it."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from hydroopt.estimation.inference.ipopt import solve_nlp


def test_an_options_file_in_the_working_directory_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                                  capfd: pytest.CaptureFixture[str]) -> None:
    """IPOPT would write to `output_file`, and load `hsllib` into this process."""
    kept = tmp_path / "kept.txt"
    kept.write_text("result of an hour")
    (tmp_path / "ipopt.opt").write_text(f"output_file {kept}\nprint_level 5\nmax_iter 0\n")
    monkeypatch.chdir(tmp_path)
    x = ca.SX.sym("x", 2)
    found = solve_nlp({"x": x, "f": ca.sumsqr(x - 1), "g": ca.SX(0, 1)}, np.zeros(2), np.full(2, -5.0),
                      np.full(2, 5.0), np.zeros(0), np.zeros(0), "test", ())
    assert found == pytest.approx([1, 1])
    assert kept.read_text() == "result of an hour"
    assert capfd.readouterr() == ("", "")
