"""Imports at first use: names of a package, and modules of extras."""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from smarttouch.base.errors import SmartTouchError


def lazy_names(package: str, where: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package, by the names that each module of the project has."""
    module_of = {name: module for module, names in where.items() for name in names.split()}

    def find(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"smarttouch.{module_of[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return find


def import_extra(
    module: str, what: str, extra: str, error: type[SmartTouchError] = SmartTouchError
) -> Any:
    """Import a module of an extra; raises an error that names the extra where it is missing."""
    try:
        return import_module(module)
    except ImportError:
        command = f"pip install 'smarttouch[{extra}]'"
        message = f"{what} needs the extra {extra}: {command}"
        raise error(message) from None
