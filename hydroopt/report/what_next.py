"""The page of what to measure next: the steps, what each is expected to gain, and what else would gain."""

from __future__ import annotations

from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np

from hydroopt.report.charts import LOOKS, Curves
from hydroopt.report.numbers import plain
from hydroopt.report.page import document

if TYPE_CHECKING:
    from hydroopt.excitation.selection.what_next import WhatNext


def render(plan: WhatNext) -> str:
    """The page as one HTML document that needs nothing else."""
    goals = plan.problem.goals
    spent = np.array([0.0, *accumulate(step.minutes for step in plan.steps)])
    targets = np.array([goal.target for goal in goals])
    lines = tuple((goal.name, LOOKS[k % len(LOOKS)], plan.stds[:, k] / targets[k]) for k, goal in enumerate(goals))
    charts = [Curves("standard deviation / target", "minutes", spent, lines, limits=(1.0,),
                     logarithmic=(False, True))] if plan.steps else []
    steps = [(plan.described(step), plain(step.minutes, 3),
              [goal.readable(std) for goal, std in zip(goals, plan.stds[k + 1].tolist(), strict=True)])
             for k, step in enumerate(plan.steps)]
    others = [(step.measurement.name, len(step.parts), plain(step.minutes, 3), plain(100 * step.rate, 3),
               [goal.readable(goal.std(step.after.covariance)) for goal in goals])
              for step in plan.alternatives]
    return document(
        "what_next.html", charts={"course": charts}, answer=plan, plan=plan,
        goals=[(goal.name, goal.readable(goal.target), goal.readable(std)) for goal, std in
               zip(goals, plan.stds[0].tolist(), strict=True)], steps=steps, others=others, sheet=plan.sheet())
