"""Bodies and friction from forces."""
