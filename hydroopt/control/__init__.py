"""The closed loop: linear models, controllers, and what a calibrated model buys on the machine."""
