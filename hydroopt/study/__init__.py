"""Studies: many independent cells of one computation, run in parallel on Dask and stored one by one."""
