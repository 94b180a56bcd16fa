"""The emulated finger and its contact over time.

Events are texts, a time in seconds and what happens then::

    2.0 lift            the finger leaves all electrodes
    3.0 touch           and is back
    0 force 0.6         it presses with 0.6 N while it touches
    0 drift 12 4 60     electrode 12's impedance goes to 4 times the healthy one in 60 s
    5 peel 7 0.3        electrode 7 keeps 0.3 of its contact area
    5 open 7            electrode 7 is cut off
    5 short 7           electrode 7 has a few ohm to the tissue
    5 heal 7            electrode 7 is as it was
    6 emergency         the emergency switch is opened, by this finger's other hand
    7 release           and closed
"""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError
from smarttouch.emulator.skin import SkinCircuit

FORCE_N = 1.0  # default force: a firm reading pressure, which does not reduce the current
OPEN_FACTOR = 5e5  # impedance factor of an open electrode: about 1 GΩ
SHORT_FACTOR = 1e-4  # impedance factor of a shorted electrode: a few ohm to the tissue
_FINEST = 0.005

FORMS = {
    "lift": "",
    "touch": "",
    "force": "NEWTON",
    "drift": "ELECTRODE FACTOR SECONDS",
    "peel": "ELECTRODE AREA",
    "open": "ELECTRODE",
    "short": "ELECTRODE",
    "heal": "ELECTRODE",
    "emergency": "",
    "release": "",
}


@dataclass(frozen=True)
class FingerEvent:
    """One event."""

    time_s: float
    kind: str
    electrode: int
    values: tuple[float, ...]


def parse_event(text: str) -> FingerEvent:
    """Return the event of a text."""
    words = text.split()
    kind = "".join(words[1:2])
    if kind not in FORMS:
        known = ", ".join(FORMS)
        raise BoardError(f"event {text!r} is unknown: write a time in s and one of {known}")
    names = ["TIME", *FORMS[kind].split()]
    try:
        numbers = {
            name: int(word) if name == "ELECTRODE" else float(word)
            for name, word in zip(names, [words[0], *words[2:]], strict=True)
        }
    except ValueError:
        form = f"TIME {kind} {FORMS[kind]}".strip()
        raise BoardError(f"event {text!r} has another form: write {form}") from None
    if not all(0 <= number < math.inf for number in numbers.values()):
        raise BoardError(f"event {text!r} has a number that is negative or not finite")
    if numbers.get("FACTOR") == 0 or not 0 < numbers.get("AREA", 1) <= 1:
        raise BoardError(
            f"event {text!r} is out of range: a FACTOR is above 0, an AREA above 0 and at most 1"
        )
    time_s, electrode = numbers.pop("TIME"), int(numbers.pop("ELECTRODE", 0))
    return FingerEvent(time_s, kind, electrode, tuple(numbers.values()))


class EmulatedFinger:
    """Finger on the electrodes, with the state of each contact; events, see the module, come in any
    order."""

    def __init__(self, electrodes: int, events: Iterable[str] = ()) -> None:
        parsed = sorted((parse_event(text) for text in events), key=lambda event: event.time_s)
        for event in parsed:
            if event.electrode >= electrodes:
                raise BoardError(
                    f"an event is of electrode {event.electrode}, the board has 0 to "
                    f"{electrodes - 1}"
                )
        switch = ("emergency", "release")
        self._due = deque(event for event in parsed if event.kind not in switch)
        self._switched = [
            (event.time_s, event.kind == "emergency") for event in parsed if event.kind in switch
        ]
        self._touches, self._pressure_n, self._drifting = True, FORCE_N, False
        self._drift = np.ones((4, electrodes))
        """Factor of each impedance before and after its drift, and when that begins and ends, s."""
        self._drifted, self._area = np.ones(electrodes), np.ones(electrodes)
        self._open = np.zeros(electrodes, np.bool_)
        self._shorted = np.zeros(electrodes, np.bool_)

    @property
    def force_n(self) -> float:
        """Current force, 0 when lifted."""
        return self._pressure_n if self._touches else 0.0

    def opens_switch(self, now_s: float) -> bool:
        """Return whether the emergency switch is open at a time."""
        before = [is_open for time_s, is_open in self._switched if time_s <= now_s]
        return bool(before) and before[-1]

    def at(self, now_s: float, skin: SkinCircuit) -> None:
        """Apply all events to the skin that are due; times must not decrease."""
        changed = False
        while self._due and self._due[0].time_s <= now_s:
            self._happen(self._due.popleft())
            changed = True
        if self._drifting:
            factor = self._factor(now_s)
            self._drifting = bool((now_s < self._drift[3]).any())
            # The circuit is solved again for each change: in steps too small to matter.
            step = np.abs(np.log(factor / self._drifted)).max()
            if step > _FINEST or not self._drifting:
                self._drifted, changed = factor, True
        if changed:
            self._apply(skin)

    def _factor(self, now_s: float) -> NDArray[np.float64]:
        """Return the factors of impedances; in equal times they change by equal ratios."""
        before, after, begins_s, ends_s = self._drift
        share = (now_s - begins_s) / np.maximum(ends_s - begins_s, 1e-9)
        return np.asarray(before * (after / before) ** np.clip(share, 0, 1))

    def _happen(self, event: FingerEvent) -> None:
        electrode, values = event.electrode, event.values
        match event.kind:
            case "lift" | "touch":
                self._touches = event.kind == "touch"
            case "force":
                self._pressure_n = values[0]
            case "drift":
                now, (factor, lasts_s) = self._factor(event.time_s)[electrode], values
                self._drift[:, electrode] = now, factor, event.time_s, event.time_s + lasts_s
                self._drifting = True
            case "peel":
                self._area[electrode] = values[0]
            case "open":
                self._open[electrode] = True
            case "short":
                self._shorted[electrode] = True
            case "heal":
                self._drift[:, electrode] = self._drifted[electrode] = self._area[electrode] = 1.0
                self._open[electrode] = self._shorted[electrode] = False

    def _apply(self, skin: SkinCircuit) -> None:
        resistance = self._drifted / self._area
        capacitance = 1 / resistance
        resistance[self._shorted] = SHORT_FACTOR
        cut = self._open | (not self._touches)
        resistance[cut], capacitance[cut] = OPEN_FACTOR, 1 / OPEN_FACTOR
        skin.scale(resistance, capacitance)
