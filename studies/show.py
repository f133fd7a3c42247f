"""What studies show beside their numbers: tables in the terminal, figures in out/studies/NAME."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from hydroopt.plots.figures import STYLE

OUT = Path(__file__).parents[1] / "out" / "studies"


def look() -> AbstractContextManager[None]:
    """The look of the reports' figures, within which a figure is drawn."""
    return matplotlib.rc_context(STYLE)


def save(figure: Figure, study: str, name: str) -> None:
    """Write a figure, drawn within the reports' style, as SVG and PNG."""
    folder = OUT / study
    folder.mkdir(parents=True, exist_ok=True)
    with look():
        figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
        figure.savefig(folder / f"{name}.png", dpi=130)


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print rows below a head as a Markdown table; numbers with three digits."""
    print(f"\n{title}\n\n| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for row in rows:
        print(f"| {' | '.join(_cell(value) for value in row)} |")
    print()


def _cell(value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    if abs(value) < 1e-9:
        return "0"
    return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}" if abs(value) < 1e6 else f"{value:.2g}"
