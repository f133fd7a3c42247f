"""What diagnostics of sensors that tell the motion say."""

from __future__ import annotations

from hydroopt.results.wording import Kind, Words

SENSOR_WORDS: dict[Kind, Words] = {
    Kind.SENSOR_MISREAD: Words(
        "In {log}, {subject} contradicts the other sensors, and agrees with {reading}: the largest misfit falls from "
        "{before:.3g} to {after:.3g} times what is stated.",
        "Correct unit, axes or mounting in the log, its map or the machine file."),
    Kind.BIAS_DRIFTS: Words(
        "The bias of {subject} changes over {log}, by {size:.2g} {unit}: it counts as constant.",
        "Let the unit warm up, shorten the log, or state a larger noise."),
    Kind.MOTION_UNEXPLAINED: Words(
        "In {log}, the residuals of {subject} are {ratio:.1f} times its stated noise.",
        "Check the accuracy of the sensor, the bandwidth of the machine, and what the machine file leaves out."),
    Kind.SATURATED: Words(
        "In {log}, {share:.1f %} of the readings of {subject} are at the end of its range; they do not count.",
        "Choose a larger range, or drive slower."),
    Kind.NOT_BY_MOTION: Words(
        "Motion and poses hardly determine {subject}: the confidence is that of the machine file.",
        "Drive other joints together, add postures at rest, or survey points of the tip."),
    Kind.POSITION_UNCERTAIN: Words(
        "In {log}, the position of {subject} is uncertain by {std:.3g} {unit} (standard deviation), although its "
        "changes are known.",
        "Survey points of the tip at rest, read its joint or cylinder in some postures, or measure where its IMU "
        "sits."),
    Kind.POSITION_ASSUMED: Words(
        "In {log}, the position of {subject} is known to {std:.2g} {unit} only (standard deviation): it changes the "
        "forces of {actuator} by {part:.1f %}, which masses and intervals leave out.",
        "Survey three points of the tip, or twelve postures at rest, and calibrate the sensors with them (--at-rest)."),
    Kind.PRESSURE_NOT_MEASURED: Words(
        "{log} lacks {subject}: only the other chamber of the actuator shows its valve and oil."),
    Kind.FORCE_NOT_MEASURED: Words(
        "{log} lacks {channels}: the equations of {subject} are not used there, those of other actuators are.",
        "Record or map what is missing; state measured = false of an actuator that is never measured."),
}
