"""Faults of boards: latched until a person clears them, and restarts at zero.

A record is a small file in the user's state folder, named by a digest of the device: its USB
vendor, product and serial number, else its port.
"""

import hashlib
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from platformdirs import user_state_path

from smarttouch.base.errors import (
    BoardLatchedError,
)
from smarttouch.base.files import make_folder, write_bytes

_MOST_BYTES = 10_000


@dataclass(frozen=True)
class Latch:
    """Record of a board's fault."""

    device: str
    reason: str
    date: str  # local time, to the second


def latch(device: str, reason: str) -> None:
    """Record a fault of a board; the first one stays."""
    if find_latch(device) is None:
        path = _path(device)
        make_folder(path.parent)
        record = Latch(device, reason, time.strftime("%Y-%m-%d %H:%M:%S"))
        write_bytes(path, json.dumps(asdict(record)).encode())


def find_latch(device: str) -> Latch | None:
    """Return the record of a board, None if there is none; an unreadable one counts as a fault."""
    try:
        with _path(device).open("rb") as file:
            record = json.loads(file.read(_MOST_BYTES))
        return Latch(device, str(record["reason"]), str(record["date"]))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        return Latch(device, f"its record {_path(device)} cannot be read ({error})", "?")


def clear_latch(device: str) -> Latch | None:
    """Remove the record of a board; return it, or None if there is none."""
    record = find_latch(device)
    if record is not None:
        _path(device).unlink(missing_ok=True)
    return record


def refuse_latched(device: str | None) -> None:
    """Raise BoardLatchedError if a board is latched."""
    if device is not None and (record := find_latch(device)) is not None:
        raise BoardLatchedError(
            f"the board ({device}) is latched since {record.date}: {record.reason}; have it "
            "checked, then clear it with smarttouch devices clear"
        )


def _path(device: str) -> Path:
    name = hashlib.sha256(device.encode()).hexdigest()[:32]
    return user_state_path("smarttouch", appauthor=False) / "latched" / f"{name}.json"
