"""What to measure next: all that is known so far, what could be measured, and what it is for."""
