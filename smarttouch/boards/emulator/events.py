"""Events of emulated devices as texts: a time in seconds, a kind, and its numbers."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from smarttouch.errors import SmartTouchError


@dataclass(frozen=True)
class Event:
    """One event of an emulated device."""

    time_s: float
    kind: str
    electrode: int = 0
    values: tuple[float, ...] = ()


def parse(text: str, forms: Mapping[str, str], error: type[SmartTouchError]) -> Event:
    """Return the event of a text. ``forms`` maps each kind to the names of its numbers:
    ``ELECTRODE`` comes first, one in brackets may be left out. Where the text cannot be understood,
    ``error`` is raised."""
    words = text.split()
    kind = next((each for each in forms if words[1:2] == [each]), None)
    if kind is None:
        what = f" is none: write a time in s and one of {', '.join(forms)}"
        raise bad_event(error, text, what)
    form = f"TIME {kind} {forms[kind]}".strip()
    try:
        electrode = int(words.pop(2)) if "ELECTRODE" in form else 0
        time_s, *values = (float(word) for word in (words[0], *words[2:]))
    except (IndexError, ValueError):
        what = f" has no number where one belongs: write {form}"
        raise bad_event(error, text, what) from None
    names = [name for name in forms[kind].split() if name != "ELECTRODE"]
    if not len(names) - form.count("[") <= len(values) <= len(names):
        what = f" has {len(values)} values after its name: write {form}"
        raise bad_event(error, text, what)
    if not all(0 <= value < math.inf for value in (time_s, *values)) or electrode < 0:
        what = " has a number that is negative or not finite"
        raise bad_event(error, text, what)
    return Event(time_s, kind, electrode, tuple(values))


def bad_event(error: type[SmartTouchError], text: str, what: str) -> SmartTouchError:
    """Return the error of an event's text."""
    message = f"event {text!r}{what}"
    return error(message, about="event")
