"""The commands that are killed, on a crane with one cylinder and the smallest sets of data that each needs."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
CRANE = """\
name = "{name}"
orientation = ["90 deg", "0 deg", "0 deg"]
sensors = [{{ channels = ["lift_cylinder.p_head", "lift_cylinder.p_rod"], accuracy = "1 bar" }}]

[[links]]
name = "lift"
joint = {{ type = "revolute", a = "2.9 m", lower = "0 deg", upper = "60 deg", max_speed = "30 deg/s" }}
body = {{ m = {{ value = "{mass} kg", sigma = "10 %" }}, com = ["1.1 m", "0 m", "0 m"], \
inertia_com = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "50 kg*m^2", "0 kg*m^2", "50 kg*m^2"] }}

[[cylinders]]
name = "lift_cylinder"
bore = "100 mm"
rod_diameter = "56 mm"
dead_length = "0.82 m"
stroke = "0.535 m"
barrel = {{ link = "base", pin = ["0.26 m", "-1.04 m", "0 m"] }}
rod = {{ link = "lift", pin = ["0.30 m", "-0.10 m", "0 m"] }}
friction = {{ coulomb = {{ value = "200 N", sigma = "2000 N" }}, viscous = "300 N*s/m" }}
"""
PANDA = f"panda_mukca {ROOT}/data/mukca_panda_2/high/hole_1.csv --map {ROOT}/data/mukca_panda_2/map.toml"


class Job(NamedTuple):
    """A command.

    Attributes:
        line: its arguments; {what} is "old" or "new", which give different results.
        saved: whether its result is an answer that `hydroopt.load` loads.
        exact: whether the same arguments give the same bytes.
    """

    line: str
    saved: bool = True
    exact: bool = True


PREPARED = ("simulate crane.toml -o one --duration 8 --rate 25 --seed 1",
            "simulate crane.toml -o two --duration 8 --rate 25 --seed 2",
            "simulate patu655_lift --driven --duration 3 --rate 50 --seed 1 -o driven")
"""Commands whose results the others read."""
JOBS = {
    "show": Job("show patu_{what}.toml --hydraulics", saved=False),
    "simulate": Job("simulate {what}.toml --duration 8 --rate 25", saved=False),
    "identify": Job("identify {what}.toml one/log.csv"),
    "identify-valves": Job("identify-valves patu_{what}.toml driven/log.csv"),
    "identify-payload": Job("identify-payload {what}.toml --unloaded one/log.csv --loaded two/log.csv"),
    "compare": Job("compare {what}.toml one/log.csv two/log.csv"),
    "calibrate": Job(f"calibrate {PANDA} --seed {{seed}}"),
    "plan-poses": Job("plan-poses cat215b -n 3 --candidates 50 --seed {seed}"),
    "excite": Job("excite {what}.toml --duration 8 --blend 1 --harmonics 2 --starts 2 --processes 2 --search-seconds 2",
                  exact=False),
    "control": Job("control patu_{what}.toml --motion driven/log.csv --controller pi"),
    "study": Job("study montecarlo crane.toml --cells 4 --duration 4 --rate 25 --processes 2", saved=False),
    "codegen": Job("codegen {what}.toml --prefix crane", saved=False)}


def prepare(folder: Path) -> None:
    """Write the machine files; old and new ones differ in a mass or in the stiffness of the oil."""
    for what, mass in (("old", 125), ("new", 150), ("crane", 125)):
        (folder / f"{what}.toml").write_text(CRANE.format(name="crane", mass=mass), encoding="utf-8")
    patu = (ROOT / "models/patu655_lift.toml").read_text(encoding="utf-8")
    for what in ("old", "new"):
        text = patu if what == "old" else patu.replace('"900 MPa"', '"950 MPa"')
        (folder / f"patu_{what}.toml").write_text(text, encoding="utf-8")
