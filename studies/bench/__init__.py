"""Benchmarks, run by ``python -m studies.bench [PART ...]``: they print which goals are met, and fail by none."""
