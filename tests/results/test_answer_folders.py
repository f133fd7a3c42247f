"""A small part of the study of answer folders of another person."""

from __future__ import annotations

from studies.first_contact import answer_folders


def test_no_reader_changes_a_folder_or_fails_and_no_writer_changes_files_elsewhere() -> None:
    found = answer_folders.run(15, seed=5, by_commands=False)
    assert found["answer_folders_tampered"] == 15
    assert 0.1 < found["answer_folders_refused"] / found["answer_folders_reads"] < 0.9
    for name in ("tracebacks", "changes_by_readers", "writes_outside"):
        assert found[f"answer_folders_{name}"] == 0, name
