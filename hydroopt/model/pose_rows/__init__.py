"""What instruments, tapes and datums read at a pose, as rows of a kinematic calibration: one kind a file."""
