"""Names that would break C, a shell or a file system: each is refused in one sentence, or builds without a warning."""

from __future__ import annotations

import json
import sys
from hashlib import sha256
from pathlib import Path

import pytest
import tomli_w

from fixtures.library import run
from fixtures.tiers import tiered
from hydroopt import cli
from hydroopt.results.json_file import SCHEMA

STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Wmissing-prototypes", "-Werror")
BODY = {"m": "100 kg", "com": ["1 m", "0 m", "0 m"],
        "inertia_com": [f"{value} kg*m^2" for value in (10, 0, 0, 100, 0, 100)]}


def description(*, machine: str = "crane", link: str = "boom", cylinder: str = "lift_cylinder",
                second: str = "") -> str:
    """A machine file: a boom on a cylinder, and a second link if it has a name."""
    links = [{"name": link, "joint": {"type": "revolute", "a": {"value": "2.8 m", "sigma": "10 mm"}, "lower": "-5 deg",
                                      "upper": "75 deg"}, "body": BODY}]
    links += [{"name": second, "joint": {"type": "locked"}, "body": BODY}] if second else []
    return tomli_w.dumps({"name": machine, "gravity": "9.81 m/s^2", "links": links, "cylinders": [
        {"name": cylinder, "bore": "100 mm", "rod_diameter": "56 mm", "dead_length": "0.82 m", "stroke": "0.535 m",
         "barrel": {"link": "base", "pin": ["0.26 m", "-1.03798675 m", "0 m"], "body": BODY},
         "rod": {"link": link, "pin": ["0.303658775 m", "-0.101611538 m", "0 m"], "body": BODY},
         "friction": {"offset": "0 N"}}]})


class Outcome:
    """How the command ended, what it said, and which files there are now that were not before."""

    def __init__(self, code: object, out: str, err: str, home: Path, before: set[Path]) -> None:
        self.code, self.out, self.err, self.home = code, out, err, home
        self.written = {file for file in home.rglob("*") if file.is_file()} - before

    def refused(self, *named: str) -> None:
        """It was refused in one sentence that holds all of what is named."""
        sentence = self.err.removesuffix("\n")
        assert self.code == 2, (self.code, self.out, self.err)
        assert self.out == ""
        assert sentence.startswith("hydroopt: ")
        assert sentence.endswith(".")
        assert sentence.isprintable(), sentence
        assert len(sentence) < 700
        assert "; " in sentence  # what is wrong, and what to do
        for each in named:
            assert each in sentence, (each, sentence)
        assert not self.written

    def builds(self) -> None:
        """It was written into the directory, and nothing else; it compiles without a warning and tests itself."""
        assert self.code == 0, self.err
        place = self.home / "out"
        assert self.written
        assert all(file.parent == place for file in self.written)
        assert not {".c", ".h"} & {file.name for file in self.written}
        done = run(["make", "check", f"CFLAGS=-O0 {' '.join(STRICT)}"], place)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "self-test passed" in done.stdout


@pytest.fixture
def codegen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """`hydroopt codegen` in a directory of its own, inside this process; its output goes to ``out``."""
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.chdir(home)

    def call(*arguments: str) -> Outcome:
        before = {file for file in tmp_path.rglob("*") if file.is_file()}
        monkeypatch.setattr(sys, "argv", ["hydroopt", "codegen", *arguments, "-o", "out", "--quiet"])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        caught = capsys.readouterr()
        outcome = Outcome(ended.value.code or 0, caught.out, caught.err, home, before)
        outcome.written |= {file for file in tmp_path.rglob("*") if file.is_file()} - before
        return outcome

    def of(text: str, *arguments: str) -> Outcome:
        (home / "machine.toml").write_text(text, encoding="utf-8")
        return call("machine.toml", *arguments)

    call.of = of
    call.home = home
    return call


HOSTILE = {
    "quote": 'a"b', "apostrophe": "a'b", "newline": "a\nb", "end of comment": "a*/b", "begin of comment": "a/*b",
    "parent folder": "../up", "absolute": "/tmp/up", "backslash": "a\\b", "trigraph": "a??/b", "blank": "a b",
    "dot": "a.b", "dash": "a-b", "semicolon": "a;b", "dollar": "a$(id)", "percent": "a%s%n", "letter": "bagger_größe",
    "empty": "", "template": "{{ 7 * 7 }}", "nul": "a\u0000b",
    "escape": "a\x1b[31mb", "bell": "a\x07b", "right to left": "a\u202eb", "digit first": "1a",
    "underscore first": "_a"}
LONG = "a" * 300


@pytest.mark.parametrize("kind", tiered(HOSTILE, lambda kind: list(HOSTILE).index(kind) % 4 == 0))
@pytest.mark.parametrize("part", tiered(["machine", "link", "cylinder"], lambda part: part == "link"))
def test_hostile_names_in_a_machine_file_are_refused(kind: str, part: str, codegen) -> None:
    name = HOSTILE[kind]
    if kind == "nul":
        text = description(**{part: "PLACE"}).replace("PLACE", "a\\u0000b")
    else:
        text = description(**{part: name})
    codegen.of(text).refused("machine.toml")


@pytest.mark.parametrize("kind", tiered(HOSTILE, lambda kind: list(HOSTILE).index(kind) % 4 == 0))
def test_hostile_prefixes_are_refused(kind: str, codegen) -> None:
    outcome = codegen.of(description(), "--prefix", HOSTILE[kind])
    if kind == "empty":
        assert outcome.code in (0, 2)  # no prefix is the machine's name
    else:
        outcome.refused("--prefix", ascii(HOSTILE[kind])[1:-1][:20].replace("\\'", "'"), "lower-case letters")


@pytest.mark.parametrize("name", tiered(
    ["int", "while", "inline", "class", "main", "nul", "_x", "x_", "a__b", "Boom", "A", LONG, "a" * 32, "9x"],
    lambda name: name in ("int", "nul", "x_", "Boom", "9x")))
def test_words_that_cannot_begin_names_are_refused_as_prefix(name: str, codegen) -> None:
    outcome = codegen.of(description(), "--prefix", name)
    outcome.refused("--prefix", f"'{name[:30]}")


@pytest.mark.parametrize("name", tiered(["int", "While", "x_", LONG], lambda name: name == "While"))
@pytest.mark.slow
def test_machines_whose_name_cannot_begin_names_take_a_prefix(name: str, codegen) -> None:
    codegen.of(description(machine=name)).refused(f"'{name.lower()[:30]}", "--prefix")
    outcome = codegen.of(description(machine=name), "--prefix", "own", "--functions", "inverse_dynamics")
    outcome.builds()
    assert {file.name for file in outcome.written} >= {"own.c", "own.h", "own_params.h", "own_selftest.c"}


@pytest.mark.parametrize("name", tiered(
    ["math", "stddef", "stdio", "features", "test", "all", "clean", "check", "install", "help", "a", "x" * 31, "null",
     "jac"], lambda name: name in ("math", "check")))
def test_words_of_libraries_and_build_tools_build_or_are_refused(name: str, codegen) -> None:
    """Also with the folder among those in which headers in angle brackets are sought, as CMake does."""
    outcome = codegen.of(description(), "--prefix", name, "--functions", "inverse_dynamics")
    if outcome.code == 2:
        outcome.refused("--prefix", f"'{name}'")
        return
    outcome.builds()
    place = codegen.home / "out"
    done = run(["cc", *STRICT, "-I.", "-fsyntax-only", *sorted(file.name for file in place.glob("*.c"))], place)
    assert done.returncode == 0, done.stderr[:2000]


@pytest.mark.needs("cmake")
@pytest.mark.parametrize("name", tiered(["test", "all", "clean", "check", "install", "help"],
                                        lambda name: name == "check"))
def test_words_of_build_tools_are_no_clash_in_cmake(name: str, codegen) -> None:
    outcome = codegen.of(description(), "--prefix", name, "--functions", "inverse_dynamics")
    if outcome.code == 2:
        outcome.refused("--prefix", f"'{name}'")
        return
    done = run(["cmake", "-S", ".", "-B", "build"], codegen.home / "out")
    assert done.returncode == 0, done.stdout[-1500:] + done.stderr[-1500:]


@pytest.mark.parametrize(("part", "name"), tiered([
    *(("link", name) for name in ("int", "while", "NULL", "count", "Count", "x_", "a__b", "M_PI")),
    *(("cylinder", name) for name in ("double", "count", "x_"))],
    lambda part, name: (part, name) in (("link", "int"), ("link", "M_PI"), ("cylinder", "count"))))
def test_words_of_c_as_names_of_parts_build_or_are_refused(name: str, part: str, codegen) -> None:
    outcome = codegen.of(description(**{part: name}), "--functions", "inverse_dynamics", "--functions",
                         "cylinder_state")
    if outcome.code == 2:
        outcome.refused(f"'{name}")
    else:
        outcome.builds()


@pytest.mark.parametrize(("names", "clash"), [
    ({"link": "boom", "second": "Boom"}, "BOOM"), ({"link": "boom", "second": "BOOM"}, "BOOM"),
    # the mass of a link called lift_cylinder_rod and that of the rod of lift_cylinder
    ({"second": "lift_cylinder_rod"}, "LIFT_CYLINDER_ROD_M"), ({"link": "boom_I", "second": "boom_i"}, "BOOM_I")])
def test_names_that_are_the_same_in_capitals_are_refused(names: dict[str, str], clash: str, codegen) -> None:
    codegen.of(description(**names)).refused(clash, "rename")


@pytest.mark.parametrize("part", tiered(["link", "cylinder", "second"], lambda part: part == "cylinder"))
@pytest.mark.slow
def test_long_names_are_refused(part: str, codegen) -> None:
    codegen.of(description(**{part: LONG})).refused("'aaaaaaaaaa", "shorten")
    codegen.of(description(**{part: "a" * 50})).refused("'aaaaaaaaaa", "shorten")
    codegen.of(description(**{part: "a" * 30}), "--functions", "inverse_dynamics").builds()


def test_ordinary_names_build(codegen) -> None:
    outcome = codegen.of(description(machine="Crane_2", second="Tip"))
    outcome.builds()
    assert {file.name.partition(".")[0].partition("_2")[0] for file in outcome.written} == {
        "crane", "CMakeLists", "Makefile", "README"}


@pytest.mark.slow
def test_the_command_itself_refuses(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(description(link="a*/b"), encoding="utf-8")
    done = run([sys.executable, "-m", "hydroopt", "codegen", "machine.toml", "-o", "out"], tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert [file.name for file in tmp_path.iterdir()] == ["machine.toml"]


# options

def test_unknown_routines_are_refused(codegen) -> None:
    codegen.of(description(), "--functions", "fly").refused("'fly'", "inverse_dynamics")
    codegen("kr300", "--functions", "closure").refused("'closure'", "neither hydraulic cylinders nor a calibrator")


def test_a_name_of_a_routine_that_is_no_word_is_shown_as_it_can_be(codegen) -> None:
    codegen.of(description(), "--functions", "a\x1b[31m\nb").refused("--functions")


def test_unknown_parameter_set_is_refused(codegen) -> None:
    codegen("cat215b", "--set", "no_such_set").refused("no_such_set")


def test_what_is_neither_machine_nor_directory_is_refused(codegen) -> None:
    codegen("no_such_machine").refused("no_such_machine")
    codegen("no_such.toml").refused("no_such.toml")


def test_output_that_cannot_be_a_directory_is_refused(codegen) -> None:
    (codegen.home / "out").write_text("a file")
    codegen.of(description()).refused("out")
    assert (codegen.home / "out").read_text() == "a file"


def test_what_else_is_in_the_directory_stays(codegen) -> None:
    (codegen.home / "out").mkdir()
    (codegen.home / "out" / "mine.c").write_text("mine")
    assert codegen.of(description(), "--functions", "inverse_dynamics").code == 0
    assert (codegen.home / "out" / "mine.c").read_text() == "mine"
    assert not list((codegen.home / "out").glob(".*"))


def test_files_that_are_not_ours_are_not_written_over(codegen) -> None:
    (codegen.home / "out").mkdir()
    (codegen.home / "out" / "crane.c").write_text("mine")
    codegen.of(description()).refused("crane.c", "not generated")
    assert [file.name for file in (codegen.home / "out").iterdir()] == ["crane.c"]


def test_files_of_an_earlier_run_go_and_those_of_another_machine_stay(codegen) -> None:
    for prefix in ("crane", "crane_2"):
        assert codegen.of(description(), "--prefix", prefix, "--functions", "inverse_dynamics").code == 0
    (codegen.home / "out" / "crane_regressor.c").write_text("/* crane: generated by hydroopt 0.1.0; see crane.h. */")
    (codegen.home / "out" / "crane_mine.c").write_text("/* mine */")
    assert codegen.of(description(), "--prefix", "crane", "--functions", "inverse_dynamics").code == 0
    names = {file.name for file in (codegen.home / "out").iterdir()}
    assert "crane_regressor.c" not in names
    assert names >= {f"{prefix}{end}" for prefix in ("crane", "crane_2")
                     for end in (".c", ".h", "_internal.h", "_params.h", "_selftest.c")} | {"crane_mine.c"}


def test_a_bundled_machine_is_meant_though_a_folder_has_its_name(codegen) -> None:
    """Who writes into a folder called like the machine must be able to do so twice."""
    (codegen.home / "patu655_lift").mkdir()
    assert codegen("patu655_lift", "--functions", "inverse_dynamics").code == 0


# estimates

def estimate(home: Path, content: object, text: str | None = None, name: str = "crane") -> str:
    place = home / "estimate"
    if isinstance(content, dict) and text is not None:
        content = content | {"files": {f"{name}.toml": sha256(text.encode()).hexdigest()}}
    place.mkdir()
    raw = content if isinstance(content, str) else json.dumps(content)
    (place / "estimate.json").write_text(raw, encoding="utf-8")
    if text is not None:
        (place / f"{name}.toml").write_text(text, encoding="utf-8")
    return "estimate"


GOOD = {"schema": SCHEMA, "job": "identification", "machine": {"name": "crane", "parameter_set": "", "sha256": ""},
        "inputs": [], "created": "2026-01-02T03:04:05+00:00", "method": "sdp", "status": "ok"}


def test_an_estimate_is_taken(codegen) -> None:
    outcome = codegen(estimate(codegen.home, GOOD, description()), "--functions", "inverse_dynamics")
    outcome.builds()
    text = (codegen.home / "out" / "crane_params.h").read_text()
    assert "estimate of crane by sdp on 2026-01-02T03:04:05+00:00" in text


def test_a_directory_without_estimate_is_refused(codegen) -> None:
    (codegen.home / "empty").mkdir()
    codegen("empty").refused("empty", "no estimate", "command wrote")


@pytest.mark.parametrize("raw", ["", "{", "[]", "1", "null", '"text"', "{}", '{"machine": "crane"}', '{"machine": {}}',
                                 '{"machine": {"name": "crane"}}', '{"machine": {"name": "crane"}, "created": 1}',
                                 "[" * 100_000, '{"a": ' + "9" * 5000 + "}", "\ud800".encode("utf-8", "surrogatepass")])
def test_a_malformed_estimate_is_refused(raw: str | bytes, codegen) -> None:
    given = estimate(codegen.home, "", description())
    (codegen.home / given / "estimate.json").write_bytes(raw if isinstance(raw, bytes) else raw.encode())
    codegen(given).refused("estimate.json", "again")


def test_an_estimate_json_that_is_a_directory_is_refused(codegen) -> None:
    (codegen.home / "estimate" / "estimate.json").mkdir(parents=True)
    codegen("estimate").refused("estimate")


def test_a_failed_estimate_is_refused(codegen) -> None:
    codegen(estimate(codegen.home, GOOD | {"status": "failed"}, description())).refused("failed", "reason")


@pytest.mark.parametrize("name", ["../up", "/etc/passwd", "..", ".", "", "a/b", "a\\b", "a\u0000b", "a\nb", "\ud800",
                                  LONG, 7, None, [], {}, ["crane"], "crane.toml", "other"])
def test_an_estimate_of_another_name_reads_no_other_file(name: object, codegen) -> None:
    """Though there is a good machine wherever the name might lead."""
    for place in (codegen.home, codegen.home.parent):
        for file in ("up.toml", "crane.toml", "other.toml"):
            (place / file).write_text(description(), encoding="utf-8")
    given = estimate(codegen.home, GOOD | {"machine": {"name": name, "parameter_set": "", "sha256": ""}}, description())
    codegen(given).refused("estimate.json")


def test_an_estimate_without_its_machine_is_refused(codegen) -> None:
    codegen(estimate(codegen.home, GOOD)).refused("estimate.json", "diagnostics")


def test_an_estimate_with_a_machine_that_cannot_exist_is_refused(codegen) -> None:
    codegen(estimate(codegen.home, GOOD, description(link="a*/b"))).refused("crane.toml")


def test_an_estimate_has_one_set_of_parameters(codegen) -> None:
    codegen(estimate(codegen.home, GOOD, description()), "--set", "other").refused("--set")


@pytest.mark.parametrize("text", tiered(["*/ int evil; /*", "a\nb\u202e", "??/\\", "x" * 1000],
                                        lambda text: "evil" in text))
def test_words_of_an_estimate_cannot_leave_their_comment(text: str, codegen) -> None:
    given = estimate(codegen.home, GOOD | {"method": text, "created": text}, description())
    outcome = codegen(given, "--functions", "inverse_dynamics")
    outcome.builds()
    assert "evil;" not in (codegen.home / "out" / "crane_params.h").read_text()
