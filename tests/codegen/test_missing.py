"""What generated code lacks is said, in the interface and by the command."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from hydroopt import load_machine
from hydroopt.cli import app
from hydroopt.machine.machine_file import dump_machine


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
