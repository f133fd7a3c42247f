"""hydroopt calibrates hydraulically actuated manipulators: a machine and its logs in, a model with error bars out."""

import os.path
import sys

# `python -m hydroopt` looks for modules in the working directory before all others; ours are not there, unless we are
if sys.argv[:1] == ["-m"] and not sys.flags.safe_path and sys.path[0] != os.path.dirname(os.path.dirname(__file__)):
    del sys.path[0]

import lazy_loader

# a name is imported from its module when it is used first; __init__.pyi lists all of them
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
