"""The answers of some sixty jobs, stored once and compared after each change of the engines below them."""
