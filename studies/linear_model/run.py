"""Linear against nonlinear model over the workspace: step responses at rest and in motion, frequency responses."""

import control
import numpy as np

from hydroopt import Model, load_machine
from hydroopt.control.linear_plant import signals, state_space
from hydroopt.model.plant import Plant

MACHINES = ("cat215b", "patu655_lift")
POSTURES = 10
SMALL = 1e-4  # part of the command between neutral and full
FINE = 1e-10  # tolerance of the integrator: small signals are small
SPEED = 0.02  # rad/s at which joints move
STEP = 0.005
REST, MOTION = 0.4, 0.1  # s: a linear model holds at rest for ever, in motion while the posture hardly changes
SAMPLE, SETTLE = 0.002, 5.0
HERTZ = (0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0)  # periods of all fit into two seconds


def run() -> dict:
    """Worst deviation over postures and joints: of a step as a part of its peak, of a gain as a part of it."""
    found: dict[str, float] = {}
    for name in MACHINES:
        machine = load_machine(name)
        found[f"{name}_step_at_rest"] = steps(Plant(Model(underlapped(machine))), 0.0, REST)
        found[f"{name}_step_in_motion"] = steps(Plant(Model(machine)), SPEED, MOTION)
        found[f"{name}_frequency"] = frequencies(Plant(Model(underlapped(machine))))
    return {name: round(value, 5) for name, value in found.items()}


def underlapped(machine):
    """The same with valves a little open at rest, so that small signals move it: within a dead band they hardly do."""
    data = machine.model_dump()
    for part in (*data["cylinders"], *data["motors"]):
        part["circuit"]["valve"] |= {"overlap": -0.1, "dead_band": 0.0}
    return type(machine).model_validate(data)


def postures(plant, seed):
    rng = np.random.default_rng(seed)
    ranges = plant.machine.ranges
    return ranges[:, 0] + rng.uniform(0.05, 0.95, (POSTURES, len(ranges))) * (ranges[:, 1] - ranges[:, 0])


def simulated(integrator, x, step, commands, supply):
    count = len(commands)
    return np.vstack([x, integrator.along(x, np.full(count, step), commands, np.tile(supply, (count, 1)))])


def steps(plant, speed, span):
    """Speeds and pressures of the joint whose valve steps, less those of the machine that goes on undisturbed."""
    psi, theta, n = plant.model.parameters.nominal, plant.parameters.nominal, len(plant.machine.joints)
    integrator, count, worst = plant.integrator(psi, theta, tolerance=FINE), round(span / STEP), 0.0
    rng = np.random.default_rng(1)
    for q in postures(plant, 1):
        at = plant.steady(q, rng.choice([-speed, speed], n), psi, theta)
        undisturbed = simulated(integrator, at.x, STEP, [at.u] * count, plant.supply)
        linear = state_space(plant, at, psi, theta, outputs=plant.states)
        for k, joint in enumerate(plant.machine.joints):
            u = np.zeros(n)
            u[k] = SMALL * abs(plant.actuators[k].valve.span)
            answer = simulated(integrator, at.x, STEP, [at.u + u] * count, plant.supply) - undisturbed
            said = np.asarray(control.forced_response(linear, STEP * np.arange(count + 1),
                                                      np.outer(u, np.ones(count + 1))).outputs)
            for i, name in enumerate(plant.states):
                if name == f"{joint}.qd" or name.startswith(f"{plant.actuators[k].actuator.name}.p"):
                    gap = np.max(np.abs(answer[:, i] - said[i])) / np.max(np.abs(said[i]))
                    worst = max(worst, float(gap))
    return worst


def frequencies(plant):
    """Gain and phase from each valve to the speed of its joint, of several sines at once after they have settled."""
    psi, theta, n = plant.model.parameters.nominal, plant.parameters.nominal, len(plant.machine.joints)
    integrator, worst = plant.integrator(psi, theta, tolerance=FINE), 0.0
    t = SAMPLE * np.arange(round((SETTLE + 2.0) / SAMPLE))
    last = slice(round(SETTLE / SAMPLE), len(t))
    rng = np.random.default_rng(2)
    for q in postures(plant, 2)[:4]:
        at = plant.steady(q, np.zeros(n), psi, theta)
        still = simulated(integrator, at.x, SAMPLE, [at.u] * len(t), plant.supply)[:-1]
        linear = state_space(plant, at, psi, theta, outputs=[f"{joint}.qd" for joint in plant.machine.joints])
        sampled = control.sample_system(linear, SAMPLE, method="zoh")
        phases = rng.uniform(0, 2 * np.pi, len(HERTZ))
        wave = sum(np.sin(2 * np.pi * f * t + phase) for f, phase in zip(HERTZ, phases, strict=True))
        for k, joint in enumerate(plant.machine.joints):
            u = np.tile(at.u, (len(t), 1))
            u[:, k] += SMALL * abs(plant.actuators[k].valve.span) * wave
            moved = simulated(integrator, at.x, SAMPLE, u, plant.supply)[:-1] - still
            speed = moved[last, plant.states.index(f"{joint}.qd")]
            for f in HERTZ:
                carrier = np.exp(-2j * np.pi * f * t[last])
                gain = (speed @ carrier) / ((u[last, k] - at.u[k]) @ carrier)
                said = sampled[tuple(signals([f"{joint}.qd", plant.inputs[k]]))](np.exp(2j * np.pi * f * SAMPLE))
                worst = max(worst, float(abs(gain - said) / abs(said)))
    return worst


if __name__ == "__main__":
    print(run())
