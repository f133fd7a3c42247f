"""Which calibrator to build, and where to mount it: the linkage of chapter 3, designed with its poses."""
