"""Studies: the thesis's tables, real machines, and benchmarks; `python -m studies [NAME...]` runs and checks them."""
