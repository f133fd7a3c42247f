"""hydroopt calibrates hydraulically actuated manipulators: a machine and its logs in, a model with error bars out."""

import os.path


def __getattr__(name: str) -> object:
    """A public name from its module: __init__.pyi lists all of them. Nothing is imported before one is used."""
    if name.startswith("__") and name != "__all__":
        raise AttributeError(name)
    if os.path.exists(os.path.join(os.path.dirname(__file__), f"{name}.py")):  # a module, which Python imports then
        raise AttributeError(name)
    import lazy_loader  # noqa: PLC0415 (so that the command can catch Ctrl-C before anything is imported)

    names = globals()
    names["__getattr__"], names["__dir__"], names["__all__"] = lazy_loader.attach_stub(__name__, __file__)
    return names["__all__"] if name == "__all__" else names["__getattr__"](name)


def __dir__() -> list[str]:
    return list(__getattr__("__all__"))
