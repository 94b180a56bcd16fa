"""Imports at first use: names of a package, and modules of extras."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from smarttouch.base.errors import SmartTouchError


def lazy_names(package: str) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package: it imports what a type checker imports there.

    That is all in the blocks ``if TYPE_CHECKING:`` of the package's source.
    """
    source = Path(str(sys.modules[package].__file__)).read_text("utf-8")
    blocks = [each for each in ast.parse(source).body if isinstance(each, ast.If)]
    module_of = {
        name.name: str(each.module)
        for block in blocks
        for each in block.body
        if isinstance(each, ast.ImportFrom)
        for name in each.names
    }

    def find(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(module_of[name]), name)
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
