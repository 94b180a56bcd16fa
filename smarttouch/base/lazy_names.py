"""Imports at first use: names of a package, modules of extras, and the cluster of one of them."""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
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


_ANSWERS_WITHIN_S = 10


@contextmanager
def on_cluster(address: str | None) -> Iterator[None]:
    """Run what is within on the Dask cluster of a scheduler (``tcp://HOST:8786``); here if None.

    Its workers need this version of SmartTouch.
    """
    if address is None:
        yield
        return
    dask = import_extra("distributed", "a cluster", "cluster")
    from joblib import parallel_config

    try:
        client = dask.Client(address, timeout=_ANSWERS_WITHIN_S, set_as_default=False)
    except (OSError, ValueError, ImportError) as error:
        raise SmartTouchError(
            f"no Dask scheduler answers at {address!r} ({error or type(error).__name__}): give its "
            "address as tcp://HOST:8786"
        ) from None
    with client, parallel_config("dask", client=client, wait_for_workers_timeout=60):
        yield
