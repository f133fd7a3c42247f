"""The report of calibrated sensors: fitted motion, residuals and parameters; computes nothing."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from hydroopt.report.charts import Chart, Line, TimeChart
from hydroopt.report.numbers import plain
from hydroopt.report.page import document
from hydroopt.report.panels import NUMBERS, printed
from hydroopt.report.samples import Recording, Samples, joined
from hydroopt.report.scene import SceneView
from hydroopt.report.tables import by_owner
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from hydroopt.estimation.motion.sensor_calibration import SensorCalibration


def render(calibration: SensorCalibration) -> str:
    """The report as one HTML page that needs nothing else."""
    machine, table = calibration.problem.machine, calibration.parameters
    samples = _samples(calibration)
    replayed = tuple(f"{joint}.q" for joint in machine.joints) if calibration.motions else ()
    courses = calibration.motions
    accuracy = [(joint, *printed(float(np.sqrt(np.mean(np.concatenate(
        [course[f"{joint}.q_std"] for course in courses]) ** 2))), machine.position_unit(joint)))
        for joint in machine.joints] if courses else []
    return document(
        "sensors.html", samples=samples, charts={"motion": _charts(calibration, samples)}, answer=calibration,
        scene=SceneView(calibration.scene, replayed), machine=machine, calibration=calibration,
        accuracy=accuracy,
        motions=len(courses), postures=sum(len(set(zip(t.stage.tolist(), t.pose.tolist(), strict=True)))
                                           for t in calibration.problem.poses),
        readings=[(channel, *printed(fit.rms, fit.unit), plain(calibration.ratios[channel], 3))
                  for channel, fit in calibration.fit["train"].items()],
        groups=list(by_owner(table, NUMBERS).items()), counts=Counter(each.identifiability for each in table.rows))


def _samples(calibration: SensorCalibration) -> Samples:
    """Fitted joint positions with the edges of their 95 % intervals, motion after motion."""
    machine, found = calibration.problem.machine, []
    for k, course in enumerate(calibration.motions):
        columns: dict[str, Array] = {}
        for joint in machine.joints:
            factor = NUMBERS[machine.position_unit(joint)][1]
            q, wide = factor * course[f"{joint}.q"], 1.96 * factor * course[f"{joint}.q_std"]
            columns |= {f"{joint}.q": course[f"{joint}.q"], joint: q, f"{joint} low": q - wide,
                        f"{joint} high": q + wide}
        found.append(Recording("motion", f"motion {k + 1}", course["t"], np.zeros(len(course["t"]), dtype=np.int64),
                               columns))
    return joined(found)


def _charts(calibration: SensorCalibration, samples: Samples) -> list[Chart]:
    """Fitted positions with their intervals; an axis shows the motion, however wide its band."""
    machine, made = calibration.problem.machine, list[Chart]()
    for joint in machine.joints if calibration.motions else ():
        q = samples.columns[joint][np.isfinite(samples.columns[joint])]
        margin = 0.2 * float(np.ptp(q)) + 1e-6
        made.append(TimeChart(f"{joint} [{NUMBERS[machine.position_unit(joint)][0]}]", (Line(joint, joint),),
                              span=(float(q.min()) - margin, float(q.max()) + margin),
                              shaded=(("predicted", f"{joint} low", f"{joint} high"),)))
    return made
