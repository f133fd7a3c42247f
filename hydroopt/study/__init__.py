"""Studies: one computation many times over, side by side on Dask, kept cell by cell so that nothing is lost."""
