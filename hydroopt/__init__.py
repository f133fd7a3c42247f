"""hydroopt calibrates hydraulically actuated manipulators: a machine and its logs in, a model with error bars out."""

import lazy_loader

# a name is imported from its module when it is used first; __init__.pyi lists all of them
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
