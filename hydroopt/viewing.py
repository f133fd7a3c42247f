"""The page of whatever one has: a machine in space, or an answer with its figures."""

from __future__ import annotations

import html
import webbrowser
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydroopt.errors import ProblemError
from hydroopt.support.files import write_files

if TYPE_CHECKING:
    from hydroopt.machine.machine import Machine
    from hydroopt.results.answer import Answer

VIEW = "view.html"
TALL = 900
"""Name of the file of a view, and its height in a notebook [px]."""


@dataclass(frozen=True, repr=False)
class View:
    """A page that needs nothing else, and the name of its machine; notebooks show it below the cell."""

    page: str
    machine_name: str

    def __repr__(self) -> str:
        return f"View({len(self.page.encode()) / 1e6:.1f} MB of HTML)"

    def _repr_html_(self) -> str:
        return (f'<iframe srcdoc="{html.escape(self.page)}" style="width: 100%; height: {TALL}px; border: 0" '
                'title="hydroopt"></iframe>')

    def save(self, directory: str | Path) -> Path:
        """Write ``view.html`` into a directory, and say where it is.

        Raises:
            ProblemError: it cannot be written.
        """
        write_files(Path(directory), {VIEW: self.page})
        return Path(directory) / VIEW

    def open(self, directory: str | Path) -> Path:
        """Write it, and show it in the browser."""
        file = self.save(directory)
        webbrowser.open(file.resolve().as_uri())
        return file


def view(shown: Any) -> View:
    """A page of a machine, of an answer, or of a folder of results.

    Args:
        shown: a `Machine`, a `Model`, the name or file of a machine, what `solve` returned, what `load` returned, or
            the folder that a command wrote.

    Raises:
        MachineError, ProblemError: there is no such machine or folder, or a folder holds no machine.

    >>> import hydroopt
    >>> page = hydroopt.view("cat215b")
    >>> page.save("out/excavator").name
    'view.html'
    """
    from hydroopt.machine.machine_file import load_machine  # noqa: PLC0415
    from hydroopt.results.answer import Answer, load  # noqa: PLC0415

    if isinstance(shown, str | Path):
        shown = load(shown) if Path(shown).is_dir() else load_machine(shown)
    if isinstance(shown, Answer) and shown.directory is not None:
        return _of_machine(shown.machine, shown)
    if isinstance(shown, Answer) and (page := page_of(shown)) is not None:
        return View(page, shown.machine_name)
    machine = getattr(shown, "machine", shown)
    if type(machine).__name__ != "Machine":
        raise ProblemError(f"a {type(shown).__name__} has no page", where="page",
                           remedy="give a Machine, its name or file, an answer, or the folder of one")
    return _of_machine(machine)


def page_of(answer: Answer) -> str | None:
    """The page of an answer that was just computed; None of a job without a page of its own."""
    from hydroopt.results.answer import KINDS  # noqa: PLC0415

    module, _, function = KINDS[type(answer).__name__][2].partition(".")
    return getattr(import_module(f"hydroopt.report.{module}"), function)(answer) if module else None


def _of_machine(machine: Machine, answer: Answer | None = None) -> View:
    from hydroopt.model.scene_graph import SceneGraph  # noqa: PLC0415
    from hydroopt.report.machine_view import render  # noqa: PLC0415

    return View(render(SceneGraph(machine), answer), machine.name)
