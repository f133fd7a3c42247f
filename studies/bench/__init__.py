"""Benchmarks, run by ``python -m studies.bench [PART ...]``: they print, and cannot fail on a slow machine."""
