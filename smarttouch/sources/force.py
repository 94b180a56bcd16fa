"""Sources of finger force: load cells, or a force that the user states.

``hx711:`` reads lines of text from Arduino sketches for the HX711. The default speed is 57,600
baud, as in the examples of the HX711 library; ``hx711:PORT?baud=115200`` sets another speed.
``loadcell:`` reads FORCE packets, see `smarttouch.sources.serial_sensors`. The profile's
``force.curve`` converts readings to newtons.
"""

import contextlib
import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SourceError, SourceLostError
from smarttouch.base.stopping import Closing
from smarttouch.base.urls import Registry
from smarttouch.base.wire.port import LINE_ERRORS, Port, open_port
from smarttouch.profile import Profile
from smarttouch.sources.serial_sensors import PacketReadings, TextReadings, read_available
from smarttouch.sources.source_contract import Device, DeviceWarnings

LARGEST_FIXED_N = 20.0


class ForceSource(Device, ABC):
    """Base class of sources of finger force."""

    is_live: ClassVar[bool] = True
    """Whether `read` returns the present force of a real finger, either measured or stated by the
    user. If it does not, a board that a finger can touch gets no current."""

    @abstractmethod
    def read(self, time_ns: int) -> float:
        """Return the force, N, at ``time_ns`` since the start of the run; NaN if unknown.

        Never wait and never raise."""


FORCES = Registry(
    "smarttouch.forces",
    ForceSource,
    SourceError,
    {
        "fixed": "smarttouch.sources.force:FixedForce",
        "hx711": "smarttouch.sources.force:open_hx711",
        "loadcell": "smarttouch.sources.force:open_load_cell",
    },
)


def open_force(url: str, profile: Profile) -> ForceSource:
    """Open a source of finger force by its URL."""
    opener, rest = FORCES.find(url)
    source: ForceSource = opener(rest, profile)
    FORCES.require_kind(source, url)
    return source


class FixedForce(ForceSource):
    """Constant force, 0 to 20 N, stated by the user: ``fixed:N``."""

    def __init__(self, text: str, profile: Profile | None = None) -> None:
        try:
            self._force_n = float(text)
        except ValueError:
            self._force_n = math.nan
        if not 0 <= self._force_n <= LARGEST_FIXED_N:
            raise SourceError(
                f"fixed:{text} is not a force: give newtons from 0 to {LARGEST_FIXED_N:g}, as in "
                "fixed:0.5"
            )
        super().__init__(f"fixed {self._force_n:g} N")

    def read(self, time_ns: int) -> float:
        """Return the force."""
        return self._force_n


FRESH_S = 0.35  # a reading is valid up to this age: load cells send at least ten readings a second
FROZEN_READINGS = 20
FROZEN_S = 2.0  # equal readings for this time are a fault, because working converters are noisy
SATURATED = (float(-(2**23)), float(2**23 - 1))
"""Extreme readings of an HX711. They mean that its load cell is overloaded or not connected."""


class CellWatch:
    """Monitor of the readings of one load cell, which adds warnings to ``notes``.

    ``presses`` returns whether a reading means that a finger presses. Constant readings are a fault
    only while a finger presses."""

    def __init__(self, title: str, notes: list[str], presses: Callable[[float], bool]) -> None:
        self._title = title
        self._presses = presses
        self._value = math.nan
        self._last_ns: int | None = None
        self._same_since_ns = 0
        self._same = 0
        self._invalid = 0
        self._warnings = DeviceWarnings(notes)
        self._longest_s = 0.0  # longest time without a reading

    def take(
        self, readings: list[float], now_ns: int, garbled: int = 0, last_garbled: str = ""
    ) -> None:
        """Add new readings, oldest first. ``garbled`` is the total number of unreadable inputs."""
        for value in readings:
            known = self._count(value)
            if known == self._value:
                self._same += 1
            else:
                self._value, self._same, self._same_since_ns = known, 1, now_ns
        if self._last_ns is not None and now_ns - self._last_ns > FRESH_S * 1e9:
            self._note_silence(now_ns - self._last_ns)
        if readings:
            self._last_ns = now_ns
            if self._frozen(now_ns):
                self._warnings.put(
                    "frozen",
                    f"{self._title}: readings did not change under pressure: the load cell is "
                    "faulty, or its sketch prints too few decimals",
                )
        if garbled:
            times = "once" if garbled == 1 else f"{garbled} times"
            self._warnings.put(
                "garbled",
                f"{self._title}: unreadable input {times}, the last was {last_garbled}: check its "
                "cable and line speed",
            )

    def lose(self, now_ns: int) -> None:
        """Discard earlier readings, because the port is lost."""
        if self._last_ns is not None:
            self._note_silence(now_ns - self._last_ns)
        self._value, self._same = math.nan, 0

    def _note_silence(self, silent_ns: int) -> None:
        self._longest_s = max(self._longest_s, silent_ns / 1e9)
        self._warnings.put(
            "silence",
            f"{self._title}: no reading for {self._longest_s:.1f} s: check its cable, and that it "
            f"sends at least ten readings a second (a reading is valid for {FRESH_S:g} s)",
        )

    def reading(self, now_ns: int) -> float:
        """Return the newest reading. Return NaN if it is invalid or too old, or if the readings do
        not change while a finger presses."""
        if self._last_ns is None or now_ns - self._last_ns > FRESH_S * 1e9:
            return math.nan
        return math.nan if self._frozen(now_ns) else self._value

    def _frozen(self, now_ns: int) -> bool:
        return (
            self._same >= FROZEN_READINGS
            and now_ns - self._same_since_ns >= FROZEN_S * 1e9
            and self._presses(self._value)
        )

    def _count(self, value: float) -> float:
        """Return the reading; if it is invalid, add a note and return NaN."""
        if value not in SATURATED and not math.isnan(value):
            return value
        self._invalid += 1
        self._warnings.put(
            "invalid",
            f"{self._title}: {self._invalid} readings without a value or at the end of the range: "
            "check that the load cell is connected and not overloaded",
        )
        return math.nan


FIRST_READING_S = 5.0
"""Longest wait for the first reading. Some boards restart for two seconds when the port opens."""
MUTE_S = 2.0  # without a reading, `LoadCell.collect` gives up no sooner than after this time
RETRY_S = 0.25  # interval of attempts to reopen a lost port
JOIN_S = 2.0  # longest wait for the end of the thread, which hangs if the port's driver hangs
LARGEST_N = 100.0  # largest plausible force of a finger; a larger force means a wrong curve
_WAIT_S = 0.05
_KINDS: dict[str, tuple[int, type[TextReadings] | type[PacketReadings]]] = {
    "hx711": (57_600, TextReadings),
    "loadcell": (921_600, PacketReadings),
}


def open_hx711(rest: str, profile: Profile) -> ForceSource:
    """Open ``hx711:PORT``, an Arduino sketch that prints one reading per line."""
    return LoadCellForce(f"hx711:{rest}", profile)


def open_load_cell(rest: str, profile: Profile) -> ForceSource:
    """Open ``loadcell:PORT``, a load cell that sends packets of `serial_sensors`."""
    return LoadCellForce(f"loadcell:{rest}", profile)


def open_cell(url: str) -> "LoadCell":
    """Open a load cell for raw readings, which are not converted to newtons."""
    # Sketches that subtract a tare send a constant 0 without contact, which is not a fault.
    return LoadCell(url, presses=lambda reading: reading != 0)


class LoadCell(Closing):
    """Load cell at ``hx711:PORT`` or ``loadcell:PORT``, optionally with ``?baud=N``. A thread
    reads the port. For ``presses``, see `CellWatch`."""

    def __init__(self, url: str, presses: Callable[[float], bool]) -> None:
        kind, name, self._baud = _parse(url)
        self._name = name
        self.title: str = f"{'HX711' if kind == 'hx711' else 'load cell'} at {name}"
        self.notes: list[str] = []
        self._readings = _KINDS[kind][1]()
        self._watch = CellWatch(self.title, self.notes, presses)
        self._news = threading.Condition()  # guards `_watch`, `_any` and `_collected`
        self._any = False
        self._collected: list[float] | None = None
        self._closing = threading.Event()
        port = open_port(name, self._baud, _WAIT_S, SourceError)
        self._thread = threading.Thread(
            target=self._listen, args=(port,), name="load cell", daemon=True
        )
        self._thread.start()
        try:
            self._await_first()
        except BaseException:
            self.close()
            raise

    def reading(self) -> float:
        """Return the newest raw reading; NaN for the reasons in `CellWatch.reading`."""
        with self._news:
            return self._watch.reading(time.perf_counter_ns())

    def collect(self, seconds: float) -> NDArray[np.float64]:
        """Return the raw readings of the next ``seconds``; wait up to `MUTE_S` for the first."""
        with self._news:
            self._collected = []
        self._closing.wait(seconds)
        # Allow at least `MUTE_S` for the first reading, because this computer can be slow.
        patience_s = max(seconds, MUTE_S)
        with self._news:
            self._news.wait_for(lambda: bool(self._collected), patience_s - seconds)
            came, self._collected = self._collected, None
        if not came:
            raise SourceError(
                f"the {self.title} sent no reading in {patience_s:g} s: check its cable and power"
            )
        return np.array(came, np.float64)

    def close(self) -> None:
        """End the thread and close the port."""
        self._closing.set()
        self._thread.join(JOIN_S)

    def _await_first(self) -> None:
        with self._news:
            if self._news.wait_for(lambda: self._any, FIRST_READING_S):
                return
        raise SourceError(
            f"the {self.title} sent no reading within {FIRST_READING_S:g} s: check that it is on, "
            f"what it sends, and its speed (now {self._baud}; set another by ?baud=N after the "
            "port)"
        )

    def _listen(self, port: Port | None) -> None:
        while not self._closing.is_set():
            if port is None:
                port = self._reopen()
                continue
            try:
                data = read_available(port, self.title)
            except SourceLostError:
                _let_go(port)
                port = None
                continue
            self._take(data)
        if port is not None:
            _let_go(port)

    def _take(self, data: bytes) -> None:
        came = self._readings.feed(data)
        now_ns = time.perf_counter_ns()
        with self._news:
            garbled, last_garbled = self._readings.garbled, self._readings.last_garbled
            self._watch.take(came, now_ns, garbled, last_garbled)
            if came:
                self._any = True
                if self._collected is not None:
                    self._collected += [value for value in came if math.isfinite(value)]
                self._news.notify_all()

    def _reopen(self) -> Port | None:
        with self._news:
            self._watch.lose(time.perf_counter_ns())
        if self._closing.wait(RETRY_S):
            return None
        try:
            port = open_port(self._name, self._baud, _WAIT_S, SourceError)
        except SourceError:
            return None
        self._readings.restart()
        return port


class LoadCellForce(ForceSource):
    """Force from a load cell and the profile's ``force.curve``."""

    def __init__(self, url: str, profile: Profile) -> None:
        if profile.force.curve is None:
            raise SourceError(
                f"profile {profile.name} has no force.curve: run smarttouch calibrate force, or, "
                "for a sketch that prints grams, set curve = [0, 0.00980665] in [force]"
            )
        self._curve = profile.force.curve
        contact_n = profile.force.contact_n
        self._cell = LoadCell(url, presses=lambda reading: self._newtons(reading) > contact_n)
        super().__init__(self._cell.title)
        self.notes: list[str] = self._cell.notes
        self._beyond = False

    def read(self, time_ns: int) -> float:
        """Return the force from the newest reading, N; NaN if unknown."""
        newtons = self._newtons(self._cell.reading())
        if newtons > LARGEST_N or math.isinf(newtons):
            if not self._beyond:
                self._beyond = True
                self.notes.append(
                    f"{self.title}: force.curve gives {newtons:.3g} N, more than a finger can "
                    "press: the curve belongs to another load cell, run smarttouch calibrate force"
                )
            return math.nan
        return newtons if math.isnan(newtons) else max(0.0, newtons)

    def close(self) -> None:
        """Close the port."""
        self._cell.close()

    def _newtons(self, reading: float) -> float:
        newtons = 0.0
        for coefficient in reversed(self._curve):
            newtons = newtons * reading + coefficient
        return newtons


def _parse(url: str) -> tuple[str, str, int]:
    """Return kind, port and speed from the URL of a load cell."""
    kind, _, rest = url.partition(":")
    if kind not in _KINDS:
        kinds = " or ".join(f"{known_kind}:PORT" for known_kind in _KINDS)
        raise SourceError(f"{url!r} is not a load cell: give {kinds}")
    name, option, speed = rest.partition("?baud=")
    if not name:
        raise SourceError(f"{url!r} has no port: give one, as in {kind}:/dev/ttyUSB0")
    if not option:
        return kind, name, _KINDS[kind][0]
    if not (speed.isdecimal() and 0 < int(speed) < 10**8):
        message = f"{url!r}: {speed!r} is not a line speed: give bits per second, as in 115200"
        raise SourceError(message)
    return kind, name, int(speed)


def _let_go(port: Port) -> None:
    with contextlib.suppress(*LINE_ERRORS):
        port.close()
