"""Whether a log can be what it says it is: its units, signs, channels and clock against the machine file."""
