"""A machine file from questions that a mechanic with a tape can answer."""
