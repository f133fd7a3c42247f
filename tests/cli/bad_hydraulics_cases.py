"""What can be wrong with the hydraulics of a machine file, and with asking for them."""

from __future__ import annotations

from pathlib import Path

from cli.bad_input_cases import DIGGER, Case, edited, show

CIRCUIT = """\
[cylinders.circuit]
volume_a = "1 L"
volume_b = "1 L"
leakage = { value = "0 m^3/(s*Pa)", sigma = "1e-13 m^3/(s*Pa)" }
[cylinders.circuit.valve]
command = "V"
neutral = "5 V"
full = "9 V"
dead_band = "0.5 V"
rated_flow = "60 L/min"
rated_drop = "35 bar"
natural_frequency = "10 Hz"
damping = 0.8
"""
FED = edited(DIGGER, "\n[[gas_cylinders]]", f"{CIRCUIT}\n[[gas_cylinders]]") + """
[oil]
bulk_modulus = "1.2 GPa"
[pump]
max_flow = "100 L/min"
pressure = "200 bar"
"""
"""The good machine file with a valve on its stick cylinder."""
VALVE = r"cylinders\[stick_cylinder\]\.circuit\.valve"


def fed(old: str, new: str, place: str) -> Case:
    """That machine file with one statement replaced."""
    return Case(lambda folder: show(folder, edited(FED, old, new)), rf"digger\.toml: {place}")


def _bundled(*arguments: str) -> Case:
    return Case(lambda folder: ["show", *arguments[:-1]], arguments[-1])


def _in_the_way(folder: Path) -> list[str]:
    (folder / "out").write_text("")
    return ["show", "patu655_lift", "--hydraulics", "-o", str(folder / "out")]


def _locked(folder: Path) -> list[str]:
    post = 'name = "post"\n[[links]]\nname = "mast"\njoint = { type = "locked" }\n'
    return [*show(folder, post, "post.toml"), "--hydraulics"]


def _of_a_file(folder: Path) -> list[str]:
    return [*show(folder, FED), "--hydraulics"]


ALL = {
    "circuit without oil": fed('[oil]\nbulk_modulus = "1.2 GPa"\n', "", r"oil: .*stick_cylinder"),
    "oil of no stiffness": fed('"1.2 GPa"', '"0 GPa"', r"oil\.bulk_modulus: .*greater than 0"),
    "stiffness of a length": fed('"1.2 GPa"', '"1.2 m"', r"oil\.bulk_modulus: 'm'.*'Pa'"),
    "oil of mere air": fed('bulk_modulus = "1.2 GPa"', 'bulk_modulus = "1.2 GPa"\nair = 0.9',
                           r"oil\.air: .*at most 0\.5"),
    "no hose volume": fed('volume_b = "1 L"\n', "", r"cylinders\[stick_cylinder\]\.circuit\.volume_b: .*missing"),
    "no valve": fed(CIRCUIT[CIRCUIT.index("[cylinders.circuit.valve]"):], "",
                    r"cylinders\[stick_cylinder\]\.circuit\.valve: .*missing"),
    "command in another unit": fed('dead_band = "0.5 V"', 'dead_band = "0.5 A"', rf"{VALVE}\.dead_band: 'A'.*'V'"),
    "command without unit": fed('neutral = "5 V"', "neutral = 5", rf"{VALVE}\.neutral: .*; .*5 V"),
    "command of unknown kind": fed('command = "V"', 'command = "bar"', rf"{VALVE}\.command: .*'1', 'V' or 'A'"),
    "open in neutral": fed('full = "9 V"', 'full = "5 V"', rf"{VALVE}\.full: "),
    "dead band beyond full opening": fed('dead_band = "0.5 V"', 'dead_band = "4.5 V"', rf"{VALVE}\.dead_band: .*4 V"),
    "negative dead band": fed('dead_band = "0.5 V"', 'dead_band = "-0.5 V"', rf"{VALVE}\.dead_band: .*at least 0"),
    "no flow": fed('rated_flow = "60 L/min"\n', "", rf"{VALVE}\.flow_pa: .*; .*'rated_flow'"),
    "flow stated twice": fed('rated_flow = "60 L/min"\n', 'rated_flow = "60 L/min"\n' + "".join(
        f'flow_{edge} = "60 L/min"\n' for edge in ("pa", "at", "pb", "bt")), rf"{VALVE}\.rated_flow: "),
    "flow without a drop": fed('rated_drop = "35 bar"\n', "", rf"{VALVE}\.rated_drop: .*missing"),
    "spool half stated": fed("damping = 0.8\n", "", rf"{VALVE}\.damping: .*; .*'damping'"),
    "supply below the tank": fed('pressure = "200 bar"', 'pressure = "200 bar"\ntank_pressure = "210 bar"',
                                 r"pump\.pressure: "),
    "a pump that gives nobody knows how much": fed('max_flow = "100 L/min"\npressure = "200 bar"\n',
                                                  'tank_pressure = "1 bar"\n', r"pump\.max_flow: .*; .*'pressure'"),
    "a line without the pump's flow": fed('max_flow = "100 L/min"\n', 'volume = "5 L"\n', r"pump\.max_flow: "),
    "a part called pump": fed('name = "bucket"', 'name = "pump"', "the name 'pump' is the supply; .*own"),
    "noise of a command in another unit": fed(
        '[[sensors]]\nchannels = ["boom.q", "stick.q"]', '[[sensors]]\nchannels = ["stick_cylinder.u"]\n'
        'accuracy = "5 mA"\n[[sensors]]\nchannels = ["boom.q", "stick.q"]',
        r"sensors\[0\]\.accuracy: 'mA'.*valve calls"),
    "leak in the wrong unit": fed('sigma = "1e-13 m^3/(s*Pa)"', 'sigma = "1e-13 m^3/s"',
                                  r".*stick_cylinder.*leakage\.sigma: "),
    "hydraulics: an actuator without circuit": Case(_of_a_file, r"digger: .*'swing_motor'; .*'circuit'"),
    "hydraulics: no hydraulic machine": _bundled("kr300", "--hydraulics", r"kr300: .*'axis1_drive'"),
    "hydraulics: nothing moves": Case(_locked, r"post: no joint moves"),
    "hydraulics: output is a file": Case(_in_the_way, r"out: "),
    "show: output without hydraulics": _bundled("cat215b", "-o", "x", r"--output: .*--hydraulics"),
}
CASES = {f"hydraulics: {name}": case for name, case in ALL.items()}
