"""What to measure: poses and motions that tell most about the parameters."""
