"""The parameters of valves, hoses, leaks and oil: names and units, bounds, and their way through machine files."""

import numpy as np

from fixtures.bad_hydraulics_cases import FED
from fixtures.bad_input_cases import edited
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.parameters.hydraulic import parameter_set

VALVE = '''\
command = "A"
neutral = "0.1 A"
full = "-900 mA"
dead_band = { value = "0.1 A", sigma = "20 mA", source = "guess" }
dead_band_reverse = { value = "0.3 A", sigma = "10 %", lower = "0.1 A", upper = "0.5 A" }
overlap = { value = -0.2, sigma = 0.05, lower = -0.5, upper = 0.3 }
rounding = 0.02
flow_bt = { value = "30 L/min", sigma = "10 %", lower = "10 L/min" }
laminar_drop = "0.2 bar"
delay = "20 ms"
'''
CIRCUIT = '''\
hose_modulus = { value = "1 GPa", sigma = "0.2 GPa" }
leakage_a = "1e-12 m^3/(s*Pa)"
anticavitation = true
'''


def everything():
    """The fed machine file with all that a circuit can state."""
    text = edited(FED, 'command = "V"\nneutral = "5 V"\nfull = "9 V"\ndead_band = "0.5 V"\n', VALVE)
    text = edited(text, 'volume_b = "1 L"\n', f'volume_b = "1 L"\n{CIRCUIT}')
    text = edited(text, 'bulk_modulus = "1.2 GPa"\n',
                  'bulk_modulus = { value = "1.2 GPa", sigma = "20 %" }\nair = 0.01\npolytropic = 1.2\n')
    return read_machine(edited(text, 'pressure = "200 bar"\n',
                               'pressure = "200 bar"\ntank_pressure = "2 bar"\nvolume = "5 L"\n'))


def test_machine_files_keep_all_that_circuits_state():
    machine = everything()
    assert read_machine(dump_machine(machine)) == machine
    found = parameter_set(machine)
    at = found.names.index("stick_cylinder.dead_band_reverse")
    assert (found.units[at], found.nominal[at], found.lower[at], found.upper[at]) == ("A", 0.3, 0.1, 0.5)
    assert found.information[at, at] == 1 / 0.03**2
    exact = found.names.index("stick_cylinder.leakage_a")
    assert found.information[exact, exact] == 0


def test_machine_files_hold_what_lies_at_the_bounds():
    """What is identified at a bound goes into a machine file that can be read, and some opening is left."""
    machine = everything()
    found = parameter_set(machine)
    for bound in (found.lower, found.upper):
        data = machine.model_dump()
        for name, value in zip(found.names, bound, strict=True):
            owner, _, key = name.partition(".")
            circuit = data["cylinders"][1]["circuit"]
            holder = data["oil"] if owner == "oil" else circuit["valve"] if key in circuit["valve"] else circuit
            if np.isfinite(value):
                holder[key] = value
        identified = type(machine).model_validate(data)
        assert read_machine(dump_machine(identified)) == identified
