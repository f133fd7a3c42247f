"""What diagnostics of poses and of the geometry that they tell say."""

from __future__ import annotations

from hydroopt.results.wording import Kind, Words

POSE_WORDS: dict[Kind, Words] = {
    Kind.JOINT_LIMITS_NARROWED: Words(
        "With the calibrated geometry the stroke of {cylinder} moves {subject} from {after}{others}. The calibrated "
        "machine has these limits instead of {before}."),
    Kind.JOINT_LIMITS_WIDENED: Words(
        "Poses of {subject} lie beyond its limits, {before}. The calibrated machine has {after}.",
        "Check the sensor's zero."),
    Kind.STROKE_CONTRADICTS_POSES: Words(
        "With the calibrated geometry the stroke of {cylinder} moves {subject} from {after} only, but {beyond} poses "
        "lie beyond.",
        "Correct dead length and stroke of {cylinder} in the machine file."),
    Kind.NOT_IDENTIFIED_BY_POSES: Words(
        "These poses do not identify {subject}.",
        "Fix them, add priors, or add poses and sensors that depend on them."),
    Kind.POSES_BREAK_LIMIT: Words(
        "{subject} is beyond its limit in pose {poses}.",
        "Leave these poses out, or correct the limit in the machine file."),
    Kind.POSES_USE_RESERVE: Words(
        "{subject} has less than its reserve in pose {poses}.",
        "Leave these poses out, or state the reserve that suffices with --reserve."),
    Kind.POSES_NOT_JUDGED: Words(
        "Limits are not judged in pose {poses}, of which the table does not state all joints.",
        "Fill in their positions, or give the postures.csv of the plan."),
    Kind.WAYS_USE_RESERVE: Words(
        "Straight ways between poses use a reserve of {subject}: {ways}.",
        "Drive one joint after another there, away from what is close."),
    Kind.POSES_LEFT_OUT: Words(
        "{count} poses were left out because they contradict the others, which makes the fit look better than the "
        "measurement was: {where}."),
    Kind.POSES_NOT_USED: Words(
        "{count} poses name no fixture and read nothing else, so that they were not used (data rows {rows})."),
    Kind.POSES_REPEATED: Words(
        "{count} poses repeat others in every reading.", "If rows were copied, intervals are too narrow: remove them."),
    Kind.NO_INTERVALS_LINK_BY_LINK: Words(
        "The link-by-link method gives no intervals.", "Use the method 'joint' for them."),
    Kind.OFF_OPTIMUM: Words(
        "Link by link, these lie far from the values that all poses together make most probable: {distances}.",
        "Use the method 'joint', or find what contradicts the poses."),
    Kind.DISTANCE_CONTRADICTS: Words(
        "The poses place {one} and {other} {measured_mm:.2f} ± {measured_std_mm:.2f} mm apart (one standard "
        "deviation), where the machine file states {stated_mm:.2f} ± {stated_std_mm:.2f} mm.",
        "Measure the distance again, or state its sigma."),
    Kind.DISTANCE_OFF: Words("The stated distance '{subject}' is wrong by {size:.2f} {unit}.", "Measure it again."),
    Kind.STAGE_ABOVE_STATED: Words(
        "Errors are larger than stated in {scales}; in the other stages they are {others:.1f} times those stated."),
    Kind.POSES_IN_ONE_PLANE: Words(
        "All joints that turned between the poses have parallel axes, so that the poses lie in one plane and geometry "
        "across it is not identifiable.", "Measure poses that leave the plane."),
    Kind.STAGE_CONTRADICTS: Words(
        "The poses of '{subject}' ({place}) contradict the others: their errors are {strength:.1f} times the usual "
        "ones."),
    Kind.STRETCH_CONTRADICTS: Words(
        "In '{subject}', {place} contradict the others: their errors are {strength:.1f} times the usual ones."),
    Kind.POSE_CONTRADICTS: Words(
        "Pose {subject} ({place}) contradicts the others: its error is {strength:.1f} times the usual one."),
    Kind.POSES_CONTRADICT: Words(
        "{count} single poses contradict the others; the worst is {subject} ({place}), with {strength:.1f} times the "
        "usual error."),
    Kind.SENSOR_OFFSET: Words("The sensor of '{subject}' reads another zero {where}, by {size:.3g} {unit}."),
    Kind.SENSOR_SCALE: Words("The sensor of '{subject}' reads a wrong scale, by {size:.2f %}."),
    Kind.BACKLASH: Words("'{subject}' has backlash: its reading depends on where it comes from, by {size:.3g} {unit}."),
    Kind.SENSOR_ECCENTRIC: Words(
        "The sensor or the gear of '{subject}' is eccentric: its error repeats once a turn, with an amplitude of "
        "{size:.3g} {unit}."),
    Kind.SENSOR_NONLINEAR: Words(
        "The sensor of '{subject}' is not linear: its error at both ends differs from that in the middle by {size:.3g} "
        "{unit}."),
    Kind.JOINT_SAGS: Words(
        "'{subject}' gives way under gravity, by up to {size:.3g} {unit}.",
        "Take it in by --compliance auto, or state its compliance with a sigma."),
    Kind.FIXTURE_MOVED: Words("The fixture '{subject}' moved by about {size:.1f} {unit} before {place}."),
    Kind.BASE_MOVED: Words("The base moved by about {size:.1f} {unit} before {place}."),
    Kind.TOOL_MOVED: Words("The tool moved on its link by about {size:.1f} {unit} before {place}."),
    Kind.INSTRUMENT_MOVED: Words(
        "The instrument '{subject}' moved by about {size:.1f} {unit} before {place}.",
        "Name another set-up from there on, in the column 'setup'."),
    Kind.SUSPECTS_UNDECIDED: Words(
        "Something contradicts the poses, and the data do not decide between: {alternatives}."),
    Kind.NO_VALIDATION_POSES: Words(
        "No pose was held out, so that the prediction of unseen poses is not known.",
        "Give --validate, --holdout or --holdout-stage."),
    Kind.WORSE_THAN_NOMINAL: Words(
        "Held-out poses fit worse after calibration than before ({subject}: {after_mm:.3g} mm against {before_mm:.3g} "
        "mm)."),
    Kind.INTERVALS_TOO_NARROW: Words(
        "Errors of held-out poses are {ratio:.1f} times those that the intervals state, and only {share:.0f %} lie "
        "within 95 %: the machine moves there in a way that the model lacks, or those poses are worse.",
        "Look for the cause in those poses, or calibrate with them: the suspects are then named."),
    Kind.LARGER_ON_VALIDATION: Words(
        "Held-out poses have {ratio:.1f} times the error of the training poses ({subject}); this method has no "
        "intervals that show whether so much is to be expected.", "Use the method 'joint'."),
    Kind.NO_REDUNDANCY: Words(
        "There are as many equations as parameters, so that the size of the errors is not known.",
        "Measure more poses."),
    Kind.ERRORS_LARGER: Words(
        "Errors are {scale:.1f} times those stated: sensors or fixtures are worse than stated, or the geometry moves "
        "in a way that the model lacks; intervals are widened accordingly."),
    Kind.ERRORS_FAR_LARGER: Words(
        "Errors are {scale:.1f} times those stated: sensors or fixtures are worse than stated, or the geometry moves "
        "in a way that the model lacks; intervals are widened accordingly."),
    Kind.ERRORS_SMALLER: Words(
        "Errors are only {scale:.2f} times those stated: sensors or fixtures are better than stated; intervals follow "
        "what is stated."),
    Kind.ONLY_TOGETHER: Words("The poses identify only a combination of {subject}."),
    Kind.NOT_DETERMINED: Words("Neither poses nor priors determine {subject}."),
    Kind.CORRELATED_ESTIMATES: Words("These poses hardly separate (correlation): {pairs}."),
    Kind.PRIOR_ALONE: Words("The machine file's confidences alone determine {subject}."),
    Kind.LITTLE_BESIDE_PRIOR: Words("These poses add little to the machine file's confidences of {subject}."),
    Kind.FAR_FROM_FILE: Words("Further from the machine file than its confidences allow: {distances}."),
    Kind.NOT_UNIQUE: Words("The solution is not unique: {count} combinations are not identifiable."),
    Kind.UNIQUENESS_NOT_EXAMINED: Words("Other solutions were not searched for.", "Give --starts."),
    Kind.OTHER_SOLUTIONS: Words("Not all initial guesses lead to this solution: {counts}."),
    Kind.HELD_AT_BOUND: Words("Held at a bound: {subject}."),
}
