"""Stack, flash and instructions on controllers: bounds against what calls write and count in the emulator."""

from __future__ import annotations

from functools import cache

import pytest

from fixtures import library
from fixtures.tiers import tiered
from hydroopt.codegen import sizes
from hydroopt.codegen.folder import Code
from hydroopt.codegen.sizes import Measured

ROUTINES = ("forward_kinematics", "inverse_dynamics", "regressor")
needs_controller = pytest.mark.needs("arm-none-eabi-gcc", "qemu-system-arm")


@cache
def measured(subject: str, real: str) -> tuple[Code, list[Measured]]:
    made = library.code(library.machine(subject), single=real == "float", routines=ROUTINES)
    return made, sizes.sizes(made.files() | made.bench, single=made.single)


@needs_controller
@pytest.mark.parametrize(("subject", "real"), tiered(
    [("patu655_lift", "float"), ("patu655_lift", "double"), ("cat215b", "float")], lambda *case: case[0] != "cat215b"))
def test_no_call_writes_more_stack_than_its_chain_may_take(subject: str, real: str) -> None:
    made, found = measured(subject, real)
    assert [each.target[:10] for each in found] == ["Cortex-M4F", "Cortex-M7"[:10]]
    for each in found:
        assert each.passed
        assert set(each.functions) == {f"{subject}_{name}" for name in (*made.routines, "prepare")}
        for size in each.functions.values():
            assert size.used is not None
            assert size.used <= size.stack < size.used + 1500  # the library's way for huge angles is not taken
            assert size.flash > 0
        assert not set(each.library) & {"memcpy", "memset", "malloc", "printf"}
        assert {"sinf" if made.single else "sin"} <= set(each.library)


@needs_controller
@pytest.mark.slow
def test_instructions_grow_with_operations() -> None:
    """As many as the operations that the folder's README counts, and not many times as many."""
    made, found = measured("cat215b", "float")
    for each in found:
        for name in ROUTINES:
            operations = sum(made.programs_of_routines[name].operations.values())
            assert operations < (each.functions[f"cat215b_{name}"].instructions or 0) < 4 * operations + 1500


@needs_controller
def test_doubles_by_software_take_many_times_as_long() -> None:
    _, found = measured("patu655_lift", "double")
    by_software, by_unit = (each.functions["patu655_lift_inverse_dynamics"].instructions or 0 for each in found)
    assert by_software > 10 * by_unit
    assert "software" in found[0].target


LISTED = """\
00008000 <outer>:
    8000:\tpush\t{r4, r5, lr}
    8002:\tvpush\t{d8-d9}
    8006:\tsub\tsp, #20
    8008:\tbl\t8100 <inner>
    800c:\tbeq.n\t8008 <outer+0x8>
    8010:\tb.w\t8200 <last>

00008100 <inner>:
    8100:\tstmdb\tsp!, {r4, r5, r6, r7, r8, lr}
    8104:\tsub.w\tsp, sp, #512\t@ 0x200
    8108:\tbx\tlr

00008200 <last>:
    8200:\tstr.w\tlr, [sp, #-8]!
    8204:\tbl\t8100 <inner>
"""


def test_frames_and_chains_are_read_from_machine_code() -> None:
    frames, calls = sizes.disassembled(LISTED)
    assert frames == {"outer": 12 + 16 + 20, "inner": 24 + 512, "last": 8}
    assert calls == {"outer": {"inner", "last"}, "inner": set(), "last": {"inner"}}
    assert sizes.deepest("outer", frames, calls) == 48 + 8 + 536
    with pytest.raises(RecursionError, match="inner calls itself"):
        sizes.deepest("outer", frames, calls | {"inner": {"last"}})


@needs_controller
def test_the_readme_states_them_per_target(monkeypatch: pytest.MonkeyPatch) -> None:
    _, found = measured("patu655_lift", "float")
    monkeypatch.setattr("hydroopt.codegen.folder.sizes", lambda files, single: found)
    text = library.code(library.machine("patu655_lift"), single=True, routines=ROUTINES, measured=True).files()[
        "README.md"]
    for each in found:
        assert f"Needs on a {each.target}" in text
        size = each.functions["patu655_lift_regressor"]
        assert (f"| `patu655_lift_regressor` | {size.stack} | {size.used} | {size.flash} | {size.instructions} |"
                in text)
    assert "and neither memcpy nor memset" in text


def test_without_a_cross_compiler_the_readme_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda _: None)
    text = library.code(library.machine("patu655_lift"), single=True, routines=ROUTINES, measured=True).files()[
        "README.md"]
    assert "Neither a cross compiler nor its C library was found" in text
