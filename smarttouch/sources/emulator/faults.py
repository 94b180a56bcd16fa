"""What goes wrong with a sensor over time.

Events are texts: seconds since the host first opened the port, what happens, and for how
many seconds; for ever if that is not given::

    2 garbage 0.5       bytes that are nothing, in place of what it would send
    3 nan 1             readings that say that there is none (load cells)
    4 freeze 3          the same image or reading again and again
    5 silent 1          nothing
    6 unplug 1.5        the port is gone; its name is valid again afterwards
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, get_args

from smarttouch.errors import SensorError

Kind = Literal["garbage", "nan", "freeze", "silent", "unplug"]


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong from a time on, for a while."""

    time_s: float
    kind: Kind
    lasts_s: float = math.inf


def parse_fault(text: str) -> Fault:
    """Return the fault of a text.

    Raises
    ------
    SensorError
        Saying what cannot be understood, and how it is written.
    """
    words = text.split()
    kind = next((each for each in get_args(Kind) if words[1:2] == [each]), None)
    if kind is None:
        raise SensorError(
            f"event {text!r} is none: write a time in s and one of {', '.join(get_args(Kind))}",
            about="event",
            problem="unknown",
            value=text,
            allowed=get_args(Kind),
        )
    try:
        times = [float(word) for word in (words[0], *words[2:])]
    except ValueError:
        times = []
    if len(times) not in (1, 2) or not all(0 <= each < math.inf for each in times):
        raise SensorError(
            f"event {text!r} has no good times: write TIME {kind} or TIME {kind} FOR",
            about="event",
            problem="malformed",
            value=text,
        )
    return Fault(times[0], kind, *times[1:])


class Faults:
    """All that goes wrong.

    Parameters
    ----------
    faults : iterable of Fault
    """

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._faults = list(faults)

    def add(self, fault: Fault) -> None:
        """Let one more thing go wrong."""
        self._faults.append(fault)

    def at(self, time_s: float) -> frozenset[Kind]:
        """Return what is wrong at a time."""
        return frozenset(
            fault.kind
            for fault in self._faults
            if fault.time_s <= time_s < fault.time_s + fault.lasts_s
        )
