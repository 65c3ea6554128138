"""Packages that one function needs and the library does not."""

from importlib.util import find_spec


def refuse_missing(what: str, **packages: str) -> None:
    """Raise a ModuleNotFoundError that says how to install what is missing.

    Args:
        what: Who needs it.
        packages: What to give to pip for each module.
    """
    for module, package in packages.items():
        if find_spec(module) is None:
            raise ModuleNotFoundError(f"{what} needs {module}: pip install {package!r}")
