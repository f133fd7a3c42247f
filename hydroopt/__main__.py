"""`python -m hydroopt`."""

from hydroopt.cli import main

main()
