"""Decoders of formats that libraries read, each in its own module; they run in a process of their own."""
