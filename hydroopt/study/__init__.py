"""Studies: many independent cells of one computation, run in parallel and stored one by one."""
