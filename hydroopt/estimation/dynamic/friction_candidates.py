"""Sets of friction terms compared by their prediction of held-out data, and the chosen set."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hydroopt.results.tables import number

STANDARD_ERRORS = 1.0
"""Standard errors of the difference by which a larger set of terms must predict better than a smaller one."""


@dataclass(frozen=True)
class Candidate:
    """A set of terms: errors are RMS over all actuators' forces, each in units of its own residual's σ.

    Attributes:
        terms: such as ``coulomb+viscous``.
        parameters: how many numbers it has, over all actuators.
        training: RMS error of the training data; NaN, as the others, where it could not be fitted.
        held_out: RMS error of held-out data; `std` its standard error.
        chosen: whether this set was chosen.
        reason: why it was chosen or not, in words.
    """

    terms: str
    parameters: int
    training: float
    held_out: float
    std: float
    chosen: bool
    reason: str


@dataclass(frozen=True)
class FrictionChoice:
    """All sets of terms that were compared over `blocks` blocks of held-out samples; `choose_friction` makes it.

    >>> rows = (Candidate("viscous", 1, 1.2, 1.3, 0.1, True, "smallest held-out error"),
    ...         Candidate("none", 0, 2.0, 2.1, 0.1, False, "squared error larger by 2.7 ± 0.2 than of viscous"))
    >>> FrictionChoice(rows, blocks=10).terms
    'viscous'
    """

    candidates: tuple[Candidate, ...]
    blocks: int

    @property
    def terms(self) -> str:
        """The terms chosen, such as ``coulomb+viscous``."""
        return next(candidate.terms for candidate in self.candidates if candidate.chosen)

    @property
    def rule(self) -> str:
        """How the terms were chosen, in words."""
        return (f"The fewest terms whose held-out error exceeds the smallest one by at most {STANDARD_ERRORS:g} "
                f"standard error of the difference, over {self.blocks} blocks of held-out samples. Errors are RMS over "
                "all actuators in units of the smallest training residual. Intervals assume that the chosen terms are "
                "right.")

    def as_dict(self) -> dict[str, Any]:
        """The entry ``friction_choice`` of estimate.json."""
        return {"rule": self.rule, "blocks": self.blocks, "candidates": [
            {"friction": c.terms, "parameters": c.parameters, "training_error": number(c.training),
             "held_out_error": number(c.held_out), "held_out_std": number(c.std), "chosen": c.chosen,
             "reason": c.reason} for c in self.candidates]}

    def __str__(self) -> str:
        width = max(len(candidate.terms) for candidate in self.candidates)
        lines = [f"  {'friction':<{width}}  parameters  training [σ]  held-out [σ]"]
        for c in self.candidates:
            mark = "*" if c.chosen else " "
            lines.append(f"{mark} {c.terms:<{width}}  {c.parameters:>10}  {c.training:>12.4f}  {c.held_out:>7.4f} ± "
                         f"{c.std:.4f}  {c.reason}")
        return "\n".join(lines)
