"""The kinds of diagnostics and the words of each: the one place where a diagnostic becomes text."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from string import Formatter
from typing import Any, NamedTuple


class _Percent(Formatter):
    """A format such as ``.0f %`` writes a part as a percentage."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if value is None:
            return "unknown"
        if format_spec.endswith(" %"):
            return f"{100 * value:{format_spec.removesuffix(' %')}} %"
        return str(super().format_field(value, format_spec))


def filled(template: str, subject: str, evidence: Mapping[str, Any]) -> str:
    """A template with a diagnostic's subject and evidence; ``{relative:.0f %}`` writes 0.25 as "25 %"."""
    return _Percent().vformat(template, (), {**evidence, "subject": subject})


class Words(NamedTuple):
    """Templates for `filled`: what was found, and what to do about it."""

    text: str
    remedy: str = ""


class Kind(StrEnum):
    """What a diagnostic is about; the value stands in JSON files."""

    # of any job
    NO_VALIDATION = "no validation data"
    FINDING = "finding in the data"
    SHORT_STRETCHES = "log split into short stretches"
    FORCE_NOT_MEASURED = "force not measured in a log"
    PRESSURE_NOT_MEASURED = "pressure not measured in a log"
    UNSTATED_BODIES = "bodies not stated"
    NO_FRICTION = "no friction stated"
    IMPOSSIBLE_NOMINAL_BODIES = "nominal bodies not physically consistent"
    GRAVITY_IDLE = "gravity does no work"
    UNMEASURED_JOINT = "forces at a joint not measured"
    IMPLAUSIBLE_SIZE = "implausible size"
    LINKAGE_IDLE = "a cylinder passes a linkage by"
    STRAIGHT_CYLINDER = "a cylinder without a linkage turns a joint far"
    BETWEEN_BRANCHES = "a posture lies between two ways to assemble a loop"

    # a log against its machine, before any fit
    LOG_MISREAD = "log misread"
    BEYOND_JOINT_LIMITS = "beyond joint limits"
    LENGTH_CONTRADICTS_ANGLE = "length contradicts angle"
    OTHER_SAMPLING_RATE = "other sampling rate"
    SENSOR_STUCK = "sensor stuck"
    SENSOR_HELD = "sensor held"
    SENSOR_SCATTERS = "sensor scatters beyond its accuracy"
    BEYOND_RELIEF = "beyond relief pressure"

    # motion by all sensors
    SENSOR_MISREAD = "sensor misread"
    BIAS_DRIFTS = "bias drifts"
    STATED_CONTRADICTED = "stated numbers contradicted"
    MOTION_UNEXPLAINED = "readings not explained by the motion"
    SATURATED = "sensor saturated"
    NOT_BY_MOTION = "not determined by motion and poses"
    POSITION_UNCERTAIN = "position of a joint uncertain"
    POSITION_ASSUMED = "uncertain position of a joint taken as exact"

    # comparison of controllers
    UNSTABLE_IN_POSTURE = "loop unstable in a posture"
    SMALL_MARGINS = "small margins"
    LITTLE_DAMPING = "little damping"
    MARGINS_BY_VALVES = "margins depend on uncertain valves"
    RUN_STOPPED = "run ended early"
    BEST_RUN_STOPPED = "even the best run ended early"
    VALVE_SATURATED = "valve saturated"

    # design of a motion
    SEARCH_CUT_SHORT = "search cut short"
    RANDOM_TELLS_MORE = "a random motion tells more"
    NOT_LIMITED = "not limited"
    LIMIT_BROKEN = "limit broken"
    RESERVE_USED = "reserve used"
    POSES_BREAK_LIMIT = "poses break limit"
    POSES_USE_RESERVE = "poses use reserve"
    POSES_NOT_JUDGED = "poses not judged"
    WAYS_USE_RESERVE = "ways use reserve"
    NO_FORCE_ACCURACY = "no accuracy of forces stated"
    NO_ANGLE_ACCURACY = "no accuracy of angles stated"
    SMOOTHING_BIAS = "bias by smoothing"
    NOT_IMPROVED = "parameters not improved"

    # identification of valves and oil
    UNEXPLAINED_FLOW = "flow not explained by the model"
    COMMANDS_LATE = "commands arrive at another time than stated"
    DELAY_EXACT = "delay taken as exact"
    SUPPLY_ASSUMED = "pressure of the supply not measured"
    NO_INFORMATION = "no information in the data"
    LITTLE_INFORMATION = "little information in the data"
    RATIO_OR_PRODUCT_ONLY = "only a ratio or product identifiable"
    COMBINATION_ONLY = "only a combination identifiable"
    PARAMETER_AT_BOUND = "parameter at a bound"

    # identification of bodies and friction
    WORSE_THAN_ZERO = "validation forces predicted worse than by zero"
    CONSTANT_ERROR = "validation forces off by a constant"
    UNEXPLAINED_ACTUATOR = "actuator not explained by the model"
    LARGE_VALIDATION_ERROR = "validation error much larger than training error"
    SAMPLING_NOT_CONVERGED = "sampling not converged"
    NO_INTERVALS = "no intervals"
    INCONSISTENT_BODIES = "bodies not physically consistent"
    NO_CALIBRATED_MACHINE = "no calibrated machine"
    RESIDUALS_ABOVE_NOISE = "residuals above the sensors' noise"
    NO_SENSOR_ERRORS = "no sensor errors in the log"
    MISFIT_CAUSE = "likeliest cause of the misfit"
    LATE_POSITIONS = "friction turns before the velocity"
    LACK_OF_FIT = "lack of fit"
    FASTER_THAN_SMOOTHING = "residuals faster than smoothing passes"
    SPIKES = "spikes"
    LINE = "line in the spectrum"
    DETECTABLE_FAULTS = "smallest faults that would show"
    FREED_FAULT = "freed fault"
    SPLIT_HALF = "halves of a log differ"
    DIFFERENT_LOGS = "logs differ"
    STATEMENT_CONTRADICTED = "statement contradicted"
    BODIES_CONTRADICTED = "prior of bodies contradicted"
    PRIORS_CONTRADICTED = "priors contradicted"
    NO_CONFIDENCE_STATED = "no confidence stated"
    WEAK_LOG_DET = "weak log-det distance"
    ACTIVE_CONSTRAINTS = "active constraints"
    NOT_EXCITED = "not excited"
    NOT_IDENTIFIABLE = "not identifiable"
    CONFOUNDED = "not separable in this motion"

    # sessions: changes and payloads
    CHANGE_DETECTED = "change detected"
    NO_CHANGE_DETECTED = "no change detected"
    CHANGE_NOT_IDENTIFIABLE = "change not identifiable"
    CHANGE_CONFOUNDED = "change not separable"
    SESSIONS_SCATTER = "sessions differ without any order"
    LOAD_IDENTIFIED = "payload identified"
    NO_LOAD_DETECTED = "no payload detected"
    LOAD_MASS_NOT_IDENTIFIABLE = "mass of the payload not identifiable"
    LOAD_MASS_CONFOUNDED = "mass of the payload not separable"
    LOAD_PARTLY_IDENTIFIABLE = "payload partly identifiable"
    LOAD_WEIGHED = "load weighed"
    LOAD_NOT_WEIGHABLE = "load not weighable"
    NO_LOAD_FOUND = "no load found"
    SCALE_CONTRADICTED = "readings contradict the scale's model"
    FORCE_SCALE_ASSUMED = "scale of force readings assumed exact"
    FORCE_SCALE_WRONG = "scale of a force reading wrong"

    # kinematic calibration and pose planning
    POSES_LEFT_OUT = "poses left out"
    POSES_NOT_USED = "poses not used"
    POSES_REPEATED = "poses repeated"
    NO_INTERVALS_LINK_BY_LINK = "no intervals link by link"
    OFF_OPTIMUM = "link by link off the optimum"
    DISTANCE_CONTRADICTS = "distance contradicts the machine file"
    DISTANCE_OFF = "distance between fixtures wrong"
    STAGE_ABOVE_STATED = "errors of a stage larger than stated"
    POSES_IN_ONE_PLANE = "poses in one plane"
    STAGE_CONTRADICTS = "stage contradicts the others"
    STRETCH_CONTRADICTS = "stretch of poses contradicts the others"
    POSE_CONTRADICTS = "pose contradicts the others"
    POSES_CONTRADICT = "single poses contradict the others"
    SENSOR_OFFSET = "sensor reads another zero"
    SENSOR_SCALE = "sensor reads a wrong scale"
    BACKLASH = "backlash"
    FIXTURE_MOVED = "fixture moved"
    BASE_MOVED = "base moved"
    TOOL_MOVED = "tool moved"
    INSTRUMENT_MOVED = "instrument moved"
    SENSOR_ECCENTRIC = "sensor or gear eccentric"
    SENSOR_NONLINEAR = "sensor not linear"
    JOINT_SAGS = "joint gives way under gravity"
    SUSPECTS_UNDECIDED = "cause of the contradiction undecided"
    NO_VALIDATION_POSES = "no validation poses"
    WORSE_THAN_NOMINAL = "held-out poses fit worse than before"
    INTERVALS_TOO_NARROW = "held-out poses beyond their intervals"
    LARGER_ON_VALIDATION = "held-out poses fit worse than training poses"
    NO_REDUNDANCY = "no redundancy"
    ERRORS_LARGER = "errors larger than stated"
    ERRORS_FAR_LARGER = "errors far larger than stated"
    ERRORS_SMALLER = "errors smaller than stated"
    ONLY_TOGETHER = "identifiable only together"
    NOT_DETERMINED = "not determined"
    CORRELATED_ESTIMATES = "correlated estimates"
    PRIOR_ALONE = "determined by the prior alone"
    LITTLE_BESIDE_PRIOR = "little information beside the prior"
    FAR_FROM_FILE = "far from the machine file"
    NOT_UNIQUE = "solution not unique"
    UNIQUENESS_NOT_EXAMINED = "uniqueness not examined"
    OTHER_SOLUTIONS = "initial guesses lead elsewhere"
    HELD_AT_BOUND = "held at a bound"
    JOINT_LIMITS_NARROWED = "joint limits narrowed"
    JOINT_LIMITS_WIDENED = "joint limits widened"
    STROKE_CONTRADICTS_POSES = "poses beyond a stroke"
    NOT_IDENTIFIED_BY_POSES = "not identified by poses"


REFUTATIONS = frozenset({Kind.LOG_MISREAD, Kind.SENSOR_MISREAD})
"""Kinds that refute an answer's data: no machine is made of it unless that is forced."""
OF_LOGS = REFUTATIONS | {Kind.BEYOND_JOINT_LIMITS, Kind.LENGTH_CONTRADICTS_ANGLE, Kind.OTHER_SAMPLING_RATE,
                         Kind.SENSOR_STUCK, Kind.SENSOR_HELD, Kind.SENSOR_SCATTERS, Kind.BEYOND_RELIEF}
"""Kinds of what contradicts the machine file in a log as it is read, before any fit."""
UNSTATED = frozenset({Kind.UNSTATED_BODIES, Kind.NO_FRICTION})
"""Kinds of what the machine file lacks: a next step before all others."""
CONTRADICTIONS = OF_LOGS | {
    Kind.SHORT_STRETCHES, Kind.STROKE_CONTRADICTS_POSES, Kind.BIAS_DRIFTS, Kind.STATED_CONTRADICTED,
    Kind.MOTION_UNEXPLAINED, Kind.POSITION_ASSUMED, Kind.MISFIT_CAUSE, Kind.LATE_POSITIONS, Kind.LACK_OF_FIT,
    Kind.FASTER_THAN_SMOOTHING, Kind.STATEMENT_CONTRADICTED, Kind.BODIES_CONTRADICTED, Kind.PRIORS_CONTRADICTED,
    Kind.WORSE_THAN_ZERO, Kind.UNEXPLAINED_ACTUATOR,
    Kind.SAMPLING_NOT_CONVERGED, Kind.UNEXPLAINED_FLOW, Kind.COMMANDS_LATE, Kind.ERRORS_FAR_LARGER,
    Kind.BEST_RUN_STOPPED,
    Kind.STAGE_CONTRADICTS, Kind.FIXTURE_MOVED, Kind.BASE_MOVED, Kind.TOOL_MOVED, Kind.INSTRUMENT_MOVED,
    Kind.SENSOR_OFFSET, Kind.SENSOR_SCALE, Kind.BACKLASH, Kind.SENSOR_ECCENTRIC, Kind.SENSOR_NONLINEAR,
    Kind.JOINT_SAGS, Kind.SUSPECTS_UNDECIDED, Kind.DISTANCE_CONTRADICTS, Kind.DISTANCE_OFF, Kind.OFF_OPTIMUM,
    Kind.INTERVALS_TOO_NARROW, Kind.SCALE_CONTRADICTED, Kind.LIMIT_BROKEN, Kind.POSES_BREAK_LIMIT}
"""Kinds that make an answer suspect."""
WORDS: dict[Kind, Words] = {
    Kind.NO_VALIDATION: Words(
        "No log was held out, so the prediction of unseen data is not known.",
        "Give --validate or --holdout."),
    Kind.FINDING: Words("{subject}: {text}"),
    Kind.SHORT_STRETCHES: Words(
        "Gaps split {subject} into stretches of {median:.2g} s in the median, too short to tell motion from noise.",
        "Smooth across the gaps, which last {longest:.2g} s at most, if no fast motion falls into them: "
        "--treat gap=keep."),
    Kind.LOG_MISREAD: Words(
        "Read with {reading}, {log} {agrees} with the machine file: {read_so}. As it is read, it contradicts the "
        "machine file: {as_read}.",
        "Correct unit, sign or column of {subject} in the file or its map; nothing was changed here."),
    Kind.BEYOND_JOINT_LIMITS: Words(
        "In {log}, {share:.0f %} of {subject} lie beyond the joint's limits: {low:.3g} to {high:.3g} {unit} against "
        "{lower:.3g} to {upper:.3g} {unit}.",
        "Correct the sensor's zero, its unit, or the limits in the machine file."),
    Kind.LENGTH_CONTRADICTS_ANGLE: Words(
        "In {log}, {subject} differs by {gap_mm:.0f} mm from what the joint angle and the pins give, where "
        "{sigma_mm:.0f} mm are one standard deviation.",
        "Correct the transducer's zero, the angle's zero, or pins and dead length in the machine file."),
    Kind.OTHER_SAMPLING_RATE: Words(
        "{log} is sampled at {rate:.3g} Hz, where the machine file states {stated:.3g} Hz.",
        "Correct the unit of time in the file or its map, or the rate of the sensors."),
    Kind.SENSOR_STUCK: Words(
        "{subject} is stuck at {value:.4g} {unit} in {count} samples of {log} (rows {rows}){evidence}.",
        "Check this sensor and its wiring, record again, or leave these samples out: --treat stuck=drop."),
    Kind.SENSOR_HELD: Words(
        "{subject}: only one sample in {every} of {log} is a new reading ({rate:.3g} Hz); the others repeat it, as "
        "many loggers do.",
        "Leave the repeated samples out: --treat held=drop; or log each group of sensors with a clock of its own."),
    Kind.SENSOR_SCATTERS: Words(
        "{subject} in {log} scatters by {noise:.3g} {unit} from sample to sample, {ratio:.2g} times its stated "
        "accuracy{reading}.",
        "Correct the unit of this column in the file or its map, or the sensor's accuracy in the machine file."),
    Kind.BEYOND_RELIEF: Words(
        "{subject} in {log} is far beyond its relief pressure of {relief_bar:.0f} bar in {share:.0f %} of the samples: "
        "up to {highest_bar:.0f} bar.",
        "Correct the unit of this column in the file or its map, or the relief pressure in the machine file."),
    Kind.UNSTABLE_IN_POSTURE: Words(
        "With {subject} errors at {hertz:.2g} Hz grow by {growth:.0%} a second in the posture of {point}, which the "
        "motion passes too fast to be disturbed, or does not reach.",
        "Do not stay there with this controller; a load that hangs almost undamped needs a brake."),
    Kind.SMALL_MARGINS: Words(
        "{subject} leaves the loop of {loop} margins of only {gain_db:.1f} dB ({gain_point}), {phase_deg:.0f} "
        "degrees ({phase_point}), and a disk margin of {disk:.2f} ({disk_point})."),
    Kind.LITTLE_DAMPING: Words(
        "With {subject} an oscillation at {hertz:.1f} Hz is damped by a ratio of only {damping:.3f} ({point}); without "
        "feedback the least is {undisturbed:.3f}.",
        "Leaks, friction and measured pressures damp oil: see the table of loops."),
    Kind.MARGINS_BY_VALVES: Words(
        "Numbers of valves and oil are so uncertain that the disk margin of {loop} with {subject} may be {low:.2f} "
        "instead of {disk:.2f} ({point}), most of all by {parameter}.",
        "Identify them: `hydroopt plan-valve-test`."),
    Kind.RUN_STOPPED: Words("With {subject} {reason}."),
    Kind.BEST_RUN_STOPPED: Words(
        "Even the best controller, {subject}, ends before the motion does.",
        "Drive a slower motion, or correct the machine's valves and pump."),
    Kind.VALVE_SATURATED: Words("With {subject} the valve of {valve} is fully open {part:.0f %} of the time."),
    Kind.SEARCH_CUT_SHORT: Words(
        "The search was cut short {how}: the motion keeps all limits, but may not be the best.",
        "Search longer, without `--search-seconds` or with more of them."),
    Kind.RANDOM_TELLS_MORE: Words(
        "The best of {motions} random motions determines more than this one: the search ended too early.",
        "Search longer (`--search-seconds`) or from more starts (`--starts`)."),
    Kind.NOT_LIMITED: Words("The machine file does not limit {subject}.", "State what must be limited."),
    Kind.LIMIT_BROKEN: Words(
        "{log}: {subject} is beyond its limit by {amount} at {at:.2f} s, the tip at ({x:.2f}, {y:.2f}, {z:.2f}) m.",
        "Drive it slower or over less range, or correct the limit in the machine file."),
    Kind.RESERVE_USED: Words(
        "{log}: {subject} uses {amount} of its reserve at {at:.2f} s, the tip at ({x:.2f}, {y:.2f}, {z:.2f}) m.",
        "Drive it slower or over less range, or state the reserve that suffices with --reserve."),
    Kind.NO_FORCE_ACCURACY: Words(
        "The machine file states no accuracy for the force of {subject}; its noise is assumed as a tenth of a typical "
        "force.",
        "State the accuracy in [[sensors]]."),
    Kind.NO_ANGLE_ACCURACY: Words(
        "The machine file states no accuracy for the angle of {subject}; it counts as exact here: the true σ will be "
        "larger than stated.",
        "State the accuracy in [[sensors]]."),
    Kind.SMOOTHING_BIAS: Words(
        "Smoothing noisy angles will bias {biased} of {of} base parameters by more than their σ.",
        "Drive slower, or measure the angles more accurately."),
    Kind.NOT_IMPROVED: Words("{count} of {of} parameters will stay about as uncertain as they are: {subject}."),
    Kind.UNEXPLAINED_FLOW: Words(
        "The flow of {subject} differs from the model by {factor:.1f} times what its sensors' errors leave; the "
        "intervals are widened.",
        "Check the sensors' accuracy and the signs of commands, and whether edges and directions differ (flow_pa, "
        "dead_band_reverse)."),
    Kind.COMMANDS_LATE: Words(
        "The commands of {subject} arrive about {by:.2g} s {sense} than the machine file's delay says (± {std:.1g} s); "
        "spool and intervals are wrong by that.",
        "State a 'sigma' of its valve's 'delay', which is then identified, or correct the clocks of the log."),
    Kind.DELAY_EXACT: Words(
        "The delays of {subject} count as exact, since the machine file states no 'sigma' of them; these logs would "
        "show an error from {least:.2g} s on, and smaller ones end in the spools' numbers.",
        "State a 'sigma' of each valve's 'delay', which is then identified."),
    Kind.SUPPLY_ASSUMED: Words(
        "{log} lacks {subject}: the supply counts as exactly {pressure:.3g} bar, but its pump gives at most {flow:.3g} "
        "L/min into a volume of its own, so that it falls under load; flows and their intervals are wrong by that.",
        "Log pump.p_supply."),
    Kind.NO_INFORMATION: Words(
        "The logs carry no information on {subject}; {determined_by} determines it.",
        "Record a motion that excites it, or remove its sigma."),
    Kind.LITTLE_INFORMATION: Words(
        "The logs alone admit {subject} from {low:.3g} to {high:.3g} {unit}; {determined_by} determines it within."),
    Kind.RATIO_OR_PRODUCT_ONLY: Words(
        "The logs determine only the {form} of {subject}; {determined_by} determines each."),
    Kind.COMBINATION_ONLY: Words("The logs determine {subject} only in combination; {determined_by} determines each."),
    Kind.PARAMETER_AT_BOUND: Words(
        "{subject} is at its {side} bound, {bound:.3g} {unit}; 95 % of its probability lies {beyond} {limit:.3g} "
        "{unit}."),
    Kind.WORSE_THAN_ZERO: Words(
        "The forces of {subject} in the validation logs are predicted worse than by zero ({relative:.0f %} error).",
        "Check signs, units and clocks of these logs, and whether they are of the same machine."),
    Kind.CONSTANT_ERROR: Words(
        "The forces of {subject} in the validation logs are off by a constant: their mean predicts them better than "
        "the estimate.",
        "Check the offset of the pressure or torque readings, and whether the load differs."),
    Kind.UNEXPLAINED_ACTUATOR: Words(
        "The model does not explain {subject}: in the {data} logs its forces are off by {relative:.0f %}, beyond its "
        "sensors' noise.",
        "Do not use the model for this actuator. Look for friction, gears or a load that the machine file lacks."),
    Kind.LARGE_VALIDATION_ERROR: Words(
        "The validation error of {subject} is {ratio:.1f} times the training error.",
        "The model is overfitted, or the motions differ in kind: train with more varied motion."),
    Kind.SAMPLING_NOT_CONVERGED: Words(
        "The sampling of the posterior did not converge: the intervals are not reliable.",
        "State confidences of the parameters that are not separable."),
    Kind.NO_INTERVALS: Words(
        "There are no intervals, because a constraint cannot be sampled: it is a nonlinear equality, has no interior, "
        "or only cvxpy understands it. Values are the most probable ones."),
    Kind.INCONSISTENT_BODIES: Words(
        "The bodies {subject} are not physically consistent. Together their parameters predict the forces, but no "
        "single one is meaningful, and no calibrated machine is written.",
        "Use the method 'sdp', which keeps bodies physically consistent."),
    Kind.NO_CALIBRATED_MACHINE: Words("No calibrated machine is written: {reason}.", "{remedy}."),
    Kind.RESIDUALS_ABOVE_NOISE: Words(
        "The residuals of {subject} are {ratio:.1f} times its sensors' noise of {noise:.3g} {unit}.",
        "Angles are noisy, or the model lacks an effect: see the figure of the residuals."),
    Kind.NO_SENSOR_ERRORS: Words(
        "The model explains the forces of {subject} to {part:.1g} of their size. No sensor reads so well: the log was "
        "simulated without errors of sensors, and all intervals are those of such a log.",
        "State the accuracy of the sensors in [[sensors]] of the machine file, and simulate again."),
    Kind.MISFIT_CAUSE: Words(
        "The likeliest cause of the misfit: {cause}, by {amount:.3g} ± {std:.2g} {unit}{others}. Both halves of the "
        "data show it alike, and it leaves no misfit.",
        "{remedy}"),
    Kind.LATE_POSITIONS: Words(
        "The positions of {joint} are read {late:.0f} ± {std:.0f} ms late: so much earlier than its velocity the dry "
        "friction of {actuator} turns, at {count} reversals.",
        "Correct the times of {joint} in the log."),
    Kind.LACK_OF_FIT: Words(
        "The residuals of {worst} {course}, {ratio:.3g} times as large as noise and smoothing explain "
        "({said}){others}. The model lacks something that is not in the list of faults, or several faults at once.",
        "Intervals hold only as far as the model does: see the figure of the residuals."),
    Kind.FASTER_THAN_SMOOTHING: Words(
        "{part:.0f %} of the residuals of {subject}, {ratio:.3g} times as large as noise explains, are faster than the "
        "{bandwidth:.2g} Hz that smoothing passes, most at {hertz:.2g} Hz: motion that smoothing takes away, as after "
        "steps of valves, or a fast effect that the model lacks.",
        "Drive smoother, without steps of the valves; or let faster motion pass (--bandwidth, or bandwidth in the "
        "machine file) where angles are exact enough."),
    Kind.SPIKES: Words(
        "Up to {share:.2g %} of the readings of {subject} are far off their neighbours.",
        "Use --treat spike=interpolate or --loss huber."),
    Kind.LINE: Words(
        "The residuals of {subject} oscillate at {hz:.3g} Hz with an amplitude of {amplitude:.3g} {unit}.",
        "Look for pulsation of the pump or a vibration of the machine."),
    Kind.DETECTABLE_FAULTS: Words(
        "Faults of these sizes would have shown with a probability of 95 %: {sizes}."),
    Kind.FREED_FAULT: Words("Freed: {cause}, by {amount:.3g} ± {std:.2g} {unit}."),
    Kind.SPLIT_HALF: Words(
        "Friction and offsets in the two halves of {subject} differ by {phi:.1f} times what noise explains "
        "({probability}); a repeat may differ by as much, which the intervals do not include.",
        "Record several logs, whose differences then widen the intervals, and let the machine warm up."),
    Kind.DIFFERENT_LOGS: Words(
        "Friction and offsets differ from log to log by {part:.0f %} of the friction force (standard deviation): the "
        "intervals are those of their mean.",
        "Compare the logs in time order with `hydroopt compare`, which states a step or drift beyond their scatter."),
    Kind.STATED_CONTRADICTED: Words(
        "The readings contradict {subject}: the {group} are {ratio:.1f} times as far off as stated ({probability}).",
        "Check these numbers, or widen the sigmas of all of their kind: what readings do not determine stays as "
        "uncertain as it is."),
    Kind.STATEMENT_CONTRADICTED: Words(
        "'{subject}' ({relation} {stated:.6g} {unit}) contradicts machine file and logs: without it, the value is "
        "{value:.6g} ± {std:.2g} {unit}, {z:.1f} standard deviations away.",
        "Correct the statement, or widen the sigmas of these parameters in the machine file."),
    Kind.BODIES_CONTRADICTED: Words(
        "The logs contradict the nominal bodies of {subject}: a factor of {factor:.2f} ± {std:.2f} on all of their "
        "parameters together would agree ({probability}, corrected for {tests} tests).",
        "Check these bodies and their sigmas in the machine file, and scales and signs of the force readings."),
    Kind.PRIORS_CONTRADICTED: Words(
        "The logs contradict the priors of the machine file: {directions} combinations of parameters together "
        "({probability}); no single body explains it.",
        "Check the sigmas of the machine file, scales and offsets of the sensors, and the friction terms."),
    Kind.NO_CONFIDENCE_STATED: Words(
        "The machine file states no confidence of {subject}: 100 % of their size is assumed.",
        "State how well their masses and centres of mass are known."),
    Kind.WEAK_LOG_DET: Words(
        "The log-det distance of {subject} is weak: before any data the mean of the bodies is up to {growth:.0f} times "
        "the nominal one.",
        "State the confidence of their masses, at most 30 %."),
    Kind.ACTIVE_CONSTRAINTS: Words("Active at the most probable parameters: {subject}."),
    Kind.NOT_EXCITED: Words(
        "The machine could identify {subject}, which this motion does not excite.",
        "Drive a motion that `hydroopt excite` designs."),
    Kind.NOT_IDENTIFIABLE: Words("No motion of this machine identifies {subject}."),
    Kind.CONFOUNDED: Words(
        "Not separable in this motion: {effects} ({subject}), whose variances are up to 10^{decades} times what they "
        "would be if the others were known.",
        "The data determine their joint effect only, and the priors the rest: reverse the motion, vary its speed and "
        "range, or state what is known."),
}
