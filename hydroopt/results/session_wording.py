"""The words of diagnostics about sessions: changes and payloads."""

from __future__ import annotations

from hydroopt.results.wording import Kind, Words

SESSION_WORDS: dict[Kind, Words] = {
    Kind.CHANGE_DETECTED: Words(
        "A change is detected: all {count} parameters together, F({rank}, {degrees_of_freedom:.0f}) = {statistic:.3g}, "
        "{probability}; {repeat} if parts of one session may differ as the halves of its logs do "
        "(φ = {phi:.2g}).{decides}"),
    Kind.NO_CHANGE_DETECTED: Words(
        "No change is detected: all {count} parameters together, F({rank}, {degrees_of_freedom:.0f}) = "
        "{statistic:.3g}, {probability}; {repeat} if parts of one session may differ as the halves of its logs do "
        "(φ = {phi:.2g}).{decides}"),
    Kind.SINGLE_CHANGE: Words("A change of {subject} alone explains it: {direction} by {amount} {unit}."),
    Kind.NO_SINGLE_CHANGE: Words(
        "No single parameter explains it: at least two changed, or something else did."),
    Kind.PARAMETER_CHANGED: Words("{subject} {direction} by {amount} {unit} ({probability})."),
    Kind.PARAMETER_UNCHANGED: Words(
        "{subject}: no change is detected ({probability}); a change above {detectable:g} {unit} would have been."),
    Kind.CHANGE_NOT_IDENTIFIABLE: Words(
        "The logs do not identify a change of {subject}.", "Drive a motion that excites it in every session."),
    Kind.CHANGE_CONFOUNDED: Words(
        "The logs cannot separate a change of {subject} from one of {partners}.",
        "Vary speed and range of the motion in every session."),
    Kind.SESSIONS_DIFFER: Words(
        "A change over the {sessions} sessions is detected: {probability} in {tests} tests of {count} parameters "
        "together."),
    Kind.SESSIONS_AGREE: Words(
        "No step or drift over the {sessions} sessions is detected: {probability} in {tests} tests of {count} "
        "parameters together."),
    Kind.SESSIONS_SCATTER: Words(
        "Friction and offsets differ from session to session without any order ({probability}), by {scatter:.2g %} of "
        "the friction force. Steps and drifts are held against that."),
    Kind.CHANGED_TOGETHER: Words("All parameters together fit {shapes}."),
    Kind.VARY_TOGETHER: Words("Neither one step nor a drift of all parameters together explains it."),
    Kind.SINGLE_COURSE: Words(
        "{subject} alone explains {what}, with {shape}: it {direction} by {amount} {unit} ({share:.0f %} of the "
        "probability of such explanations)."),
    Kind.PARAMETER_AGREES: Words(
        "{subject} agrees over all sessions ({probability}); a step above {detectable:g} {unit} at {where} would have "
        "been detected."),
    Kind.PARAMETER_SCATTERS: Words(
        "{subject} differs from session to session by more than residuals explain, but without any order "
        "({probability} of no step or drift); a step above {detectable:g} {unit} at {where} would have been detected."),
    Kind.MORE_CHANGED: Words(
        "What the parameters named below did does not explain all of it ({probability}): something else changed, too."),
    Kind.PARAMETER_NOT_VISIBLE: Words(
        "{subject} is hardly visible: only a step above {detectable:g} {unit} at {where} would have been detected, "
        "more than its assumed size of {size:g} {unit}."),
    Kind.PARAMETER_STEPPED: Words(
        "{subject} {direction} by {amount} {unit} at session {session}{log} ({probability})."),
    Kind.PARAMETER_DRIFTED: Words(
        "{subject} drifted: it {direction} by {amount} {unit} from the first session to the last ({probability})."),
    Kind.PARAMETER_VARIES: Words(
        "{subject} differs from session to session ({probability}); neither one step nor a drift explains it."),
    Kind.PARAMETER_UNDECIDED: Words(
        "{subject} changed ({probability}), but these logs do not decide between {alternatives}."),
    Kind.LOAD_IDENTIFIED: Words("The load on {subject} is {mass} kg{place}."),
    Kind.NO_LOAD_DETECTED: Words("No load is detected on {subject} ({probability}){mass}."),
    Kind.LOAD_MASS_NOT_IDENTIFIABLE: Words(
        "These logs do not identify the mass of the load on {subject}{moment}."),
    Kind.LOAD_MASS_CONFOUNDED: Words(
        "These motions cannot separate the mass of the load on {subject} from its other parameters.",
        "Vary speed and range of the motion with the load."),
    Kind.LOAD_PARTLY_IDENTIFIABLE: Words(
        "These motions do not identify {subject} of the load.", "Move the load about more axes."),
    Kind.LOAD_WEIGHED: Words("{subject} weighs {mass} kg (95 %), carried from {begin:.1f} to {end:.1f} s."),
    Kind.LOAD_NOT_WEIGHABLE: Words(
        "{subject}, carried from {begin:.1f} to {end:.1f} s, cannot be weighed: {why}.",
        "Move several joints for some seconds with it."),
    Kind.NO_LOAD_FOUND: Words(
        "No load was found from {begin:.1f} to {end:.1f} s: nothing differs from the tare.",
        "The log must begin with the empty machine, and go on with a load."),
    Kind.SCALE_CONTRADICTED: Words(
        "Readings contradict the calibrated model: residuals are {misfit:.1f} times as large as expected.",
        "Check where the load's centre of mass is (--centre, --centre-sigma), signs and channels of pressures, that "
        "the machine was empty during the tare, the tool, and the calibration."),
    Kind.FORCE_SCALE_ASSUMED: Words(
        "Force readings are assumed to be right in scale: a common relative error of all of them, as of piston areas "
        "or sensors' scales, becomes that of the mass.",
        "State with --gain-error how large their relative errors may be. In weigh, one known load determines them "
        "(--known)."),
    Kind.FORCE_SCALE_WRONG: Words(
        "By the known load the force of {subject} is read {percent} % too {way}; the masses are corrected for it.",
        "Correct its piston areas or torque per pressure in the machine file, or its sensors' scale, and calibrate "
        "again."),
    Kind.NO_INTERIOR: Words(
        "Bounds or bodies leave no interior to sample: intervals are those of least squares without bounds."),
}
