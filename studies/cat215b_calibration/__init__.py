"""Chapter 3 on the CAT 215B: run.py runs it, its parts stand beside."""
