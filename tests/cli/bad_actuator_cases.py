"""What can be wrong with the identification of valves, and with driving them."""

from __future__ import annotations

from pathlib import Path

from cli.bad_input_cases import Case, edited

CRANE = (Path(__file__).parents[2] / "studies" / "actuator_coverage" / "crane.toml").read_text()
HEADER = "t [s],lift.q [deg],jack.u [V],jack.p_head [bar],jack.p_rod [bar],pump.p_supply [bar],pump.p_tank [bar]"
ROWS = [(f"{k / 50}", f"{30 + k / 100}", "4.8", "90", "40", "180", "1") for k in range(50)]


def log(without: str = "", **values: str) -> str:
    """A good log of the crane but for a channel, or with a channel that stands at a value."""
    names = HEADER.split(",")
    kept = [k for k, name in enumerate(names) if not (without and name.startswith(without))]
    held = dict(values)
    lines = [",".join(names[k] for k in kept)]
    for row in ROWS:
        lines.append(",".join(held.get(names[k].partition(" ")[0].replace(".", "_"), row[k]) for k in kept))
    return "\n".join(lines) + "\n"


def identify(folder: Path, machine: str, data: str, *options: str) -> list[str]:
    (folder / "crane.toml").write_text(machine)
    (folder / "log.csv").write_text(data)
    return ["identify", str(folder / "crane.toml"), str(folder / "log.csv"), "--hydraulics", "-o",
            str(folder / "out"), *options]


def refused(place: str, machine: str = CRANE, data: str | None = None, options: tuple[str, ...] = ()) -> Case:
    return Case(lambda folder: identify(folder, machine, log() if data is None else data, *options), place)


def _simulate(folder: Path, *options: str) -> list[str]:
    (folder / "crane.toml").write_text(CRANE)
    (folder / "log.csv").write_text(log(jack_u="3.9", lift_q="70"))
    return ["simulate", str(folder / "crane.toml"), "-o", str(folder / "out"), *options]


UNFED = CRANE[: CRANE.index("[cylinders.circuit]")] + CRANE[CRANE.index("[[sensors]]") :]
UNSENSED = CRANE[: CRANE.index("[[sensors]]")]

CASES = {
    "valves: no command": refused(r"log\.csv: .*'jack\.u'.*; .*jack\.u", data=log(without="jack.u")),
    "valves: no pressure": refused(r"log\.csv: .*'jack\.p_rod'", data=log(without="jack.p_rod")),
    "valves: no motion": refused(r"log\.csv: .*'lift\.q'", data=log(without="lift.q")),
    "valves: no supply": refused(r"crane: pump: .*supply.*; .*pump\.p_supply",
                                 edited(CRANE, 'pressure = "180 bar"\n', ""), log(without="pump.p_supply")),
    "valves: command within the dead band": refused(r"log\.csv: .*'jack\.u' never leaves the dead band.*V; ",
                                                    data=log(jack_u="5.6")),
    "valves: no circuit": refused(r"crane: .*feeds 'jack'; .*circuit", UNFED),
    "valves: no sensors": refused(r"'crane': .*jack\.p_head.*; .*accuracy", UNSENSED),
    "valves: idle option": refused(r"--method: .*; ", options=("--method", "qp")),
    "valves: bodies without valves": Case(
        lambda folder: [a for a in identify(folder, CRANE, log(), "--bodies") if a != "--hydraulics"], "--bodies: "),
    "driven: out of range": Case(lambda folder: _simulate(
        folder, "--commands", str(folder / "log.csv"), "--quiet"), r"lift out of its range after"),
    "driven: commands and a motion": Case(lambda folder: _simulate(
        folder, "--commands", str(folder / "log.csv"), "--driven"), "--commands: "),
    "driven: no circuit": Case(lambda folder: ["simulate", "panda", "--driven", "-o", str(folder / "out")],
                               "panda: .*driven directly"),
}
