"""Commands killed at random moments: what stands in the folder, what still runs, what was said."""
