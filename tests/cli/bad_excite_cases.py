"""What can be wrong with a motion or with poses that are asked for, in the form of `bad_input_cases`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cli.bad_input_cases import GOOD_LOG, Case, constant, header, written


def excite(*more: str, place: str) -> Case:
    return Case(lambda d: ["excite", "patu655_lift", "-o", str(d / "out"), *more], place)


def excite_with(change: Callable[[list[str]], list[str]], place: str) -> Case:
    """A motion that is to add to the good log with its lines changed."""
    return Case(lambda d: ["excite", "patu655_lift", "-o", str(d / "out"), "--log",
                           str(written(d, "\n".join(change(list(GOOD_LOG))) + "\n", "log.csv"))], place)


QUICK = ("--duration", "8", "--harmonics", "2", "--seconds", "1", "--starts", "1", "--processes", "1")


def _trajectory_in_the_way(folder: Path) -> list[str]:
    (folder / "out" / "trajectory.csv").mkdir(parents=True)
    return ["excite", "patu655_lift", "-o", str(folder / "out"), *QUICK]


def _excitation_in_the_way(folder: Path) -> list[str]:
    written(folder, "a file", "out")
    return ["excite", "patu655_lift", "-o", str(folder / "out"), *QUICK]


ALL = {
    "unknown criterion": excite("--criterion", "Q", place="criterion: 'Q' .*; .*condition"),
    "unknown focus": excite("--focus", "bucket", place="focus: .*'bucket'.*; .*payload"),
    "condition number of a focus": excite("--focus", "friction", "--criterion", "condition", place="criterion: "),
    "unknown joint rests": excite("--rest", "stick=0 deg", place="excitation: 'stick' .*; .*lift"),
    "joint rests nowhere": excite("--rest", "lift", place="--rest: 'lift' .*; .*=0 deg"),
    "joint rests without a unit": excite("--rest", "lift=0", place="--rest lift: '0' "),
    "joint rests at a length": excite("--rest", "lift=0 m", place="--rest lift: 'm' "),
    "joint rests out of its range": excite("--rest", "lift=100 deg", place="excitation: joint 'lift' .*range"),
    "joint rests at no number": excite("--rest", "lift=nan deg", place="lift"),
    "all joints rest": excite("--rest", "lift=0 deg", place="excitation: all joints rest"),
    "harmonics beyond the bandwidth": excite("--harmonics", "40", place="excitation: .*bandwidth.*; .*harmonics"),
    "pieces beyond the bandwidth": excite("--pieces", "99", place="excitation: .*bandwidth.*; .*pieces"),
    "more harmonics than functions may be": excite("--harmonics", "100000", place="excitation: "),
    "more pieces than functions may be": excite("--pieces", "100000", place="excitation: "),
    "no pieces": excite("--pieces", "0", place="excite: .*'--pieces'"),
    "no harmonics": excite("--harmonics", "0", place="excite: .*'--harmonics'"),
    "period longer than the duration": excite("--duration", "10", "--period", "12", place="--period: .*12 s.* 10 s"),
    "negative period": excite("--period", "-1", place="--period: .*-1 s"),
    "period not a number": excite("--period", "nan", place="--period: .*nan"),
    "duration that entry and exit take up": excite("--duration", "3", place=" 3 s .*entry.*; .*duration"),
    "negative duration": excite("--duration", "-5", place="--duration: .*-5 s"),
    "duration not a number": excite("--duration", "nan", place="--duration: .*nan"),
    "endless duration": excite("--duration", "inf", place="--duration: .*inf"),
    "absurd duration": excite("--duration", "1e9", place="--duration: .*1e\\+09 s"),
    "rate of zero": excite("--rate", "0", place="excitation: at 0 Hz"),
    "negative rate": excite("--rate", "-50", place="excitation: at -50 Hz"),
    "rate not a number": excite("--rate", "nan", place="excitation: at nan Hz"),
    "more samples than can be checked": excite("--rate", "1e9", place="excitation: .*samples"),
    "rate that leaves no samples": excite("--rate", "0.001", place="excitation: .*0.001 Hz.*; .*(higher|longer)"),
    "rate that leaves too few samples": excite(*QUICK, "--rate", "1", place="excitation: .*samples.*; .*rate"),
    "no time to search": excite("--seconds", "0", place="excite: .*'--seconds'"),
    "blend not a number": excite("--blend", "nan", place="excite: .*'--blend'"),
    "motion's option for poses": excite("--poses", "5", "--duration", "3", place="--duration: .*; .*--poses"),
    "no poses": excite("--poses", "0", place="excite: .*'--poses'"),
    "poses of what nothing holds": excite("--poses", "5", place="machine 'patu655_lift': .*; .*fixture"),
    "poses by an unknown criterion": excite("--poses", "5", "--criterion", "Q", place="criterion: 'Q'"),
    "log that is not there": excite("--log", "none.csv", place=r"none\.csv: "),
    "log of another machine": excite_with(lambda lines: [line.rpartition(",")[0] for line in header(
        "lift.q", "tilt.q")(lines)], r"log\.csv: .*'lift\.q'"),
    "log in which nothing moves": excite_with(constant, r"log\.csv: no joint moves"),
    "output is a file": Case(_excitation_in_the_way, "/out(/c)?: "),
    "directory where the trajectory goes": Case(_trajectory_in_the_way, "out"),
}
CASES = {f"excite: {name}": case for name, case in ALL.items()}
