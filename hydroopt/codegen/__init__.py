"""C for the machine's controller, from the same symbols as the model in Python."""
