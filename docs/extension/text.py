"""Text of the code in Markdown."""

from hydroopt.errors import visible


def cell(text: str) -> str:
    """Text in a cell of a table; code between backticks stays code."""
    text = visible(" ".join(text.split())).replace("``", "`")
    parts = text.split("`")
    for k, part in enumerate(parts):
        if k % 2 == 0:
            for mark in "<*_[":
                part = part.replace(mark, f"\\{mark}")  # noqa: PLW2901
        parts[k] = part.replace("|", "\\|")
    return "`".join(parts)
