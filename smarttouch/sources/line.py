"""Reading of a serial line without waiting for more than has arrived."""

import contextlib

from smarttouch.errors import SourceLostError
from smarttouch.wire.port import LINE_ERRORS, Port, reason

_LARGEST_READ = 65536


def read_available(port: Port, title: str) -> bytes:
    """Return the bytes that have arrived; wait for the first up to the port's timeout."""
    try:
        # Waiting for one byte more than has arrived would take the whole timeout.
        data = bytes(port.read(port.in_waiting or 1))
        # Over TCP pyserial never reports how much has arrived.
        wire = getattr(port, "_socket", None)
        if data and wire is not None:
            with contextlib.suppress(BlockingIOError):
                data += wire.recv(_LARGEST_READ)
    except LINE_ERRORS as error:
        raise SourceLostError(f"{title} was disconnected: {reason(error)}", about="port") from None
    return data
