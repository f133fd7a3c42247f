"""The figures of what one has: ``estimate.plot.forces()``, ``machine.plot.machine()``."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.errors import ProblemError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hydroopt.estimation.dynamic.estimate import Estimate


class Plots:
    """Figures of a machine, a model or an answer, as matplotlib's; notebooks show them, ``figure.savefig`` keeps them.

    >>> import hydroopt as ho
    >>> figure = ho.load_machine("patu655_lift").plot.machine()
    >>> figure.savefig("crane.png")
    >>> log = ho.simulate("patu655_lift", ho.random_trajectory("patu655_lift", duration=10, rate=20, seed=1), seed=1)
    >>> estimate = ho.solve(ho.identification_problem("patu655_lift", log), "wls")
    >>> [len(figure.axes) > 0 for figure in (estimate.plot.forces(), estimate.plot.residuals())]
    [True, True]
    """

    def __init__(self, shown: Any) -> None:
        self._shown = shown

    def __repr__(self) -> str:
        return f"Plots of {self._shown!r}: forces(), residuals(), parameters(), machine()"

    def forces(self) -> Figure:
        """Measured and predicted forces over time, of an identification.

        Raises:
            ProblemError: this is no identification.
        """
        from hydroopt.plots.figures import forces  # noqa: PLC0415 (matplotlib takes long to load)

        return _notebook(forces(self._estimate("forces")))

    def residuals(self) -> Figure:
        """Residuals of the forces over time and velocity, of an identification.

        Raises:
            ProblemError: this is no identification.
        """
        from hydroopt.plots.figures import residuals  # noqa: PLC0415

        return _notebook(residuals(self._estimate("residuals")))

    def parameters(self) -> Figure:
        """Changes of the parameters from the machine file to the answer, with their intervals.

        Raises:
            ProblemError: this has no parameters that differ from those of a machine file.
        """
        from hydroopt.plots.figures import changes  # noqa: PLC0415
        from hydroopt.results.answer import Answer  # noqa: PLC0415

        figure = changes(self._shown.parameters) if isinstance(self._shown, Answer) else None
        if figure is None:
            raise self._refusal("parameters")
        return _notebook(figure)

    def machine(self) -> Figure:
        """The machine from the side: at the mean and the extremes of the training motion, or of its ranges.

        Raises:
            ProblemError: this is not about one machine.
        """
        from hydroopt.estimation.dynamic.estimate import Estimate  # noqa: PLC0415
        from hydroopt.machine.machine_file import machine_of  # noqa: PLC0415
        from hydroopt.model.model import Model  # noqa: PLC0415
        from hydroopt.model.vertical_plane import limit_postures, range_postures  # noqa: PLC0415
        from hydroopt.plots.side_view import side_view  # noqa: PLC0415

        if isinstance(self._shown, Estimate) and self._shown.directory is None:
            problem = self._shown.problem
            moved = np.concatenate([each.plotted.motion.q for each in problem.experiments])
            drawn = side_view(problem.model, range_postures(problem.model, moved), "mean of the training motion",
                              "its extremes")
        else:
            model = Model(machine_of(self._shown, "plot.machine"))
            drawn = side_view(model, limit_postures(model), "middle of all ranges", "limits of each joint")
        return _notebook(drawn)

    def _estimate(self, what: str) -> Estimate:
        from hydroopt.estimation.dynamic.estimate import Estimate  # noqa: PLC0415

        if not isinstance(self._shown, Estimate) or self._shown.directory is not None:
            raise self._refusal(what)
        return self._shown

    def _refusal(self, what: str) -> ProblemError:
        name = type(self._shown).__name__
        article = "an" if name[0] in "AEIOU" else "a"
        return ProblemError(f"{article} {name} has no {what} to draw", where=f"plot.{what}",
                            remedy="draw what hydroopt.solve returned, or see the page of hydroopt.view")


def _notebook(figure: Figure) -> Figure:
    """The figure with what notebooks ask for, in the look of the pages."""
    from hydroopt.plots.figures import svg  # noqa: PLC0415

    setattr(figure, "_repr_svg_", partial(svg, figure))  # noqa: B010 (matplotlib's type does not know it)
    return figure
