"""One question of the guided start, and what an answer to it may be."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from hydroopt.errors import HydrooptError
from hydroopt.results.readable import readable
from hydroopt.units import to_si

TYPICAL = ""
"""The answer that takes the typical value."""


class AnswerError(Exception):
    """An answer cannot be taken; the text says why, and what would be."""


@dataclass(frozen=True)
class Question:
    """What is asked, in words of a mechanic.

    Attributes:
        key: name of the answer in a file of answers.
        text: the question.
        unit: SI unit of a length, mass or torque; ``1`` of a count, "" where `choices` are words.
        typical: what is assumed if the answer is empty, in SI or one of the choices.
        hint: how to measure it.
        choices: words that may be answered.
        least, most: of a number, in SI.
    """

    key: str
    text: str
    unit: str
    typical: float | str
    hint: str = ""
    choices: tuple[str, ...] = ()
    least: float = 0.0
    most: float = 100.0

    @property
    def shown(self) -> str:
        """The typical answer as it would be typed."""
        if isinstance(self.typical, str):
            return self.typical
        if self.unit == "m":
            return f"{1e3 * self.typical:.0f} mm"
        if self.unit == "rad":
            return f"{math.degrees(self.typical):.0f} deg"
        return f"{self.typical:.0f}" if self.unit == "1" else f"{float(f'{self.typical:.3g}'):g} {self.unit}"

    def read(self, text: str) -> float | str:
        """The value of an answer in SI, or one of the choices.

        Raises:
            AnswerError: it cannot be read, or lies outside what can be.

        >>> Question("boom.length", "From pin to pin?", "m", 5.0).read("18 ft")
        5.4864
        """
        text = text.strip()
        if text == TYPICAL:
            return self.typical
        if self.choices:
            found = [word for word in self.choices if word.startswith(text.lower())]
            if len(found) != 1:
                raise AnswerError(f"'{text}' is none of {', '.join(self.choices)}")
            return found[0]
        if not self.unit:
            if re.fullmatch(r"[A-Za-z]\w{0,63}", text, re.ASCII) is None:
                raise AnswerError(f"'{text}' is not a name: begin with a letter, then use letters, digits and _")
            return text
        text = _with_point(text)
        try:
            value = float(text) if self.unit == "1" else to_si(text, self.unit, where="answer")
        except ValueError:
            raise AnswerError(f"'{text}' is not a number") from None
        except HydrooptError as error:
            raise AnswerError(f"{error.what}: write a number with its unit, such as {self.shown}") from None
        if not self.least <= value <= self.most or (self.unit == "1" and value != int(value)):
            bounds = " to ".join(readable(bound, self.unit, 3) for bound in (self.least, self.most))
            whole = "a whole number from " if self.unit == "1" else ""
            raise AnswerError(f"{text} is outside what is possible here: {whole}{bounds}")
        return value


def _with_point(text: str) -> str:
    """A number whose decimal comma cannot mean thousands, with a point.

    Raises:
        AnswerError: it may mean either.

    >>> _with_point("1,85 m"), _with_point("0,125 m"), _with_point("1.85 m")
    ('1.85 m', '0.125 m', '1.85 m')
    """
    found = re.match(r"([+-]?\d+),(\d+)(?![\d.,])", text)
    if found is None:
        return text
    whole, decimals = found.groups()
    if len(decimals) == 3 and whole.strip("+-0"):
        raise AnswerError(f"'{text}' may mean thousands or decimals: write a point for decimals, and nothing for "
                          "thousands")
    return f"{whole}.{decimals}{text[found.end():]}"
