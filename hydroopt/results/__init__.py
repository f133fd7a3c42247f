"""What every job answers: status, diagnostics, a table of parameters, and how an answer is saved and loaded."""
