"""What generated code lacks is said, in the interface and by the command."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fixtures.closures import UPRIGHT, jack, link, made
from fixtures.tools import must
from hydroopt import load_machine
from hydroopt.cli import app
from hydroopt.codegen import self_test
from hydroopt.machine.machine_file import dump_machine


@pytest.mark.parametrize("others", [("inverse_dynamics",), pytest.param((), marks=pytest.mark.slow)])
def test_a_routine_without_states_for_the_self_test_is_named(others: tuple[str, ...], tmp_path: Path,
                                                             monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(self_test, "CLEAR", np.inf)
    monkeypatch.setattr(self_test, "TRIES", 2)
    named = [word for name in ("tip_wrench", *others) for word in ("--functions", name)]
    done = CliRunner().invoke(app, ["codegen", "patu655", "-o", str(tmp_path), *named, "--quiet"])
    said = ("the self-test leaves out tip_wrench, since none of 2 tries found states that determine every result "
            "clearly")
    assert done.exit_code == 0, done.output
    assert [line for line in done.stderr.splitlines() if "self-test" in line] == [f"! {said}"]
    assert f"- Not tested: {said}." in (tmp_path / "README.md").read_text()
    assert "self-test passed" in must(["make", "check"], tmp_path)
    assert ("patu655_inverse_dynamics(" in (tmp_path / "patu655_selftest.c").read_text()) == bool(others)


def test_one_joint_that_a_cylinder_moves_with_what_follows_it_has_its_state_by_the_length(tmp_path: Path) -> None:
    """As the ram between both arms of a scissor lift: no other joint is given."""
    machine = made("folding", [link("boom", a=2.0, lower=0.3, upper=1.0), link("jib", "boom", a=1.5)],
                   orientation=UPRIGHT,
                   couplings=[{"name": "gears", "joint": "jib", "ratios": {"boom": -2.0}, "offset": -0.3}],
                   cylinders=[jack("ram", ("base", (0.4, -0.9, 0.0)), ("jib", (0.3, -0.2, 0.0)))])
    (tmp_path / "folding.toml").write_text(dump_machine(machine))
    done = CliRunner().invoke(app, ["codegen", str(tmp_path / "folding.toml"), "-o", str(tmp_path / "c"), "--functions",
                                    "joint_state", "--quiet"])
    assert done.exit_code == 0, done.output
    assert "self-test passed" in must(["make", "check"], tmp_path / "c")


@pytest.mark.slow
def test_closure_names_fixtures_that_it_holds_in_position_only(tmp_path: Path) -> None:
    crane = load_machine("cat215b")
    first, *rest = crane.fixtures
    hinged = crane.model_copy(update={"fixtures": (first.model_copy(update={"kind": "hinge"}), *rest)})
    (tmp_path / "hinged.toml").write_text(dump_machine(hinged))
    said = {}
    for name in ("cat215b", str(tmp_path / "hinged.toml")):
        done = CliRunner().invoke(app, ["codegen", name, "-o", str(tmp_path / Path(name).stem), "--functions",
                                        "closure", "--quiet"])
        assert done.exit_code == 0, done.output
        assert done.stdout == ""
        said[name] = [line for line in done.stderr.splitlines() if line.startswith("missing: closure.orientation")]
    assert said == {"cat215b": [], str(tmp_path / "hinged.toml"): [
        f"missing: closure.orientation, since fixtures {first.name} are no balls, and this routine compares the tip's "
        "position with the fixture's only"]}
    assert "`orientation` is missing" in "".join(
        path.read_text() for path in (tmp_path / "hinged").glob("*.h"))
