"""Work that joblib hands to the user's Dask cluster."""

from collections.abc import Iterator
from contextlib import contextmanager

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.lazy_names import import_extra

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
            "address as tcp://HOST:8786",
            about="cluster",
        ) from None
    with client, parallel_config("dask", client=client, wait_for_workers_timeout=60):
        yield
