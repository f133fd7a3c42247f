"""What diagnostics of a machine file alone say."""

from __future__ import annotations

from hydroopt.results.wording import Kind, Words

MACHINE_WORDS: dict[Kind, Words] = {
    Kind.UNSTATED_BODIES: Words(
        "Bodies are missing or placeholders, so that nominal forces are not the machine's: {found}.",
        "State {what} of each {where}, if need be as a guess with its sigma."),
    Kind.NO_FRICTION: Words(
        "No friction is stated of {subject} or their actuators: the option --friction coulomb+viscous of identify adds "
        "it.", "Identify with that option, or state coulomb and viscous in the 'friction' of its drives."),
    Kind.IMPOSSIBLE_NOMINAL_BODIES: Words(
        "No body can have the mass, centre of mass and inertia that the machine file states of {subject}: a principal "
        "moment of inertia is negative or exceeds the sum of the other two.",
        "Correct them; moments of inertia of 'inertia_com' are about the centre of mass, those of 'inertia' about the "
        "origin of the frame."),
    Kind.GRAVITY_IDLE: Words(
        "Gravity does no work on any joint ({subject}): as the file states them, the axes of all joints that turn are "
        "vertical, so that holding still takes no force and shows nothing of masses.",
        "If joints turn about level axes, state it: orientation = [\"90 deg\", \"0 deg\", \"0 deg\"] turns the base "
        "frame's y axis up."),
    Kind.UNMEASURED_JOINT: Words(
        "{unmeasured} not measured: the forces at {subject} are in no equation, neither predicted nor compared with "
        "any log.",
        "For {subject}, {remedy}."),
    Kind.IMPLAUSIBLE_SIZE: Words("{subject} is {size}, but {usual}.", "{remedy}"),
    Kind.STRAIGHT_CYLINDER: Words(
        "{subject} is pinned to the link itself and turns it by {range_deg:.0f} deg. Where a joint turns as far, a "
        "rocker and a coupler mostly stand between; left out, they make lever arms wrong by up to a fifth.",
        "If the machine has them, state them by [[linkages]] and pin the rod to the rocker."),
    Kind.LINKAGE_IDLE: Words(
        "{what}.", "If the linkage moves {moves}, {remedy}."),
    Kind.BETWEEN_BRANCHES: Words(
        "The posture of {subject} lies between the two ways to assemble it: {near} from the one that is taken and "
        "{far} from the other.",
        "State the posture of the machine more closely: {stands}."),
}
