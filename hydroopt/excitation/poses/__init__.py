"""The poses to measure next."""
