"""The words of diagnostics about sessions: changes and payloads."""

from __future__ import annotations

from hydroopt.results.wording import Kind, Words

SESSION_WORDS: dict[Kind, Words] = {
    Kind.CHANGE_DETECTED: Words("Changed by {where}: {what} ({probability})."),
    Kind.NO_CHANGE_DETECTED: Words("No change over the {sessions} sessions ({probability})."),
    Kind.SESSIONS_SCATTER: Words(
        "Sessions differ by more than residuals explain ({probability}){size}{most}; a change must exceed that."
        "{within}"),
    Kind.CHANGE_NOT_IDENTIFIABLE: Words(
        "The logs do not identify a change of {subject}.", "Drive a motion that excites it in every session."),
    Kind.CHANGE_CONFOUNDED: Words(
        "The logs cannot separate changes of {subject} from one another.",
        "Vary speed and range of the motion in every session."),
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
}
