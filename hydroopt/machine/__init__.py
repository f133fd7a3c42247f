"""What a machine is: links, joints, actuators, valves, sensors, environment; its files and geometry."""
