"""Emulated sensors: frames of an array, readings of a load cell, sent at a steady rate."""

import sys
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SourceError
from smarttouch.emulator.firmware import DeviceClock, Firmware
from smarttouch.profile import Profile
from smarttouch.sources import open_source
from smarttouch.sources.force import RecordedForce
from smarttouch.sources.sensor_protocol import encode_force, encode_frame
from smarttouch.sources.source_contract import Frame

GRAVITY_N_PER_G = 9.80665e-3
_LONGEST_WAIT_S = 0.02
_BEHIND_NS = 100_000_000  # after this delay the schedule restarts, as hardware sends no burst
_BLOCK = 4
_PATTERN_SIDE = 1024
_PATTERN_PIXELS_S = 40
_LARGEST_RAW = 2**23 - 1

Look = Callable[[float], NDArray[np.uint8]]  # function from a time in seconds to the image, (H, W)


class SensorFirmware(Firmware):
    """Sends what a sensor measures at absolute deadlines, without waiting."""

    longest_step_ns: int = (
        sys.maxsize
    )  # its time never stands still: hosts compare it with their own
    backlog = 1

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = 1e9 / rate_hz
        self._start_ns: int | None = None
        self._next_ns = 0.0
        self._number = 0

    def wait_s(self, clock: DeviceClock) -> float:
        left_s = (self._next_ns - clock.now_ns()) / 1e9
        return min(max(left_s, 0.0), _LONGEST_WAIT_S)

    def idle(self, now_ns: int) -> None:
        self._next_ns = now_ns + self._period_ns

    def advance(self, now_ns: int) -> bytes:
        if self._start_ns is None:
            self._start_ns = now_ns
            self._next_ns = now_ns
        if now_ns < self._next_ns:
            return b""
        if now_ns - self._next_ns > _BEHIND_NS:
            self._next_ns = now_ns
        self._next_ns += self._period_ns
        number, self._number = self._number, self._number + 1
        return self.packet(number, (now_ns - self._start_ns) / 1e9)

    @abstractmethod
    def packet(self, number: int, time_s: float) -> bytes:
        """Return the next bytes for the line."""


class SensorArray(SensorFirmware):
    """A sensor array; ``look`` returns its image at a time."""

    def __init__(self, look: Look, rate_hz: float) -> None:
        super().__init__(rate_hz)
        self._look = look
        self._image: NDArray[np.uint8] | None = None

    def packet(self, number: int, time_s: float) -> bytes:
        if "freeze" not in self.wrong or self._image is None:
            self._image = self._look(time_s)
        return encode_frame(number, round(time_s * 1e6), self._image)


class EmulatedLoadCell(SensorFirmware):
    """A load cell with its converter: ``force_n`` returns the force at a time, N (NaN is none);
    line and noise are in counts. ``framed`` sends packets instead of lines of text."""

    def __init__(
        self,
        force_n: Callable[[float], float],
        counts_per_n: float = 50_000.0,
        zero: float = 80_000.0,
        noise: float = 60.0,
        framed: bool = False,
        seed: int = 0,
        rate_hz: float = 80.0,
    ) -> None:
        super().__init__(rate_hz)
        self._force_n = force_n
        self._line = (counts_per_n, zero, noise)
        self._framed = framed
        self._random = np.random.default_rng(seed)
        self._reading: int | None = None

    def packet(self, number: int, time_s: float) -> bytes:
        if "freeze" not in self.wrong or self._reading is None:
            self._reading = self._convert(time_s)
        reading = None if "nan" in self.wrong else self._reading
        if self._framed:
            return encode_force(number, round(time_s * 1e6), reading)
        return f"HX711 reading: {'nan' if reading is None else reading}\r\n".encode()

    def take_order(self, words: list[str]) -> bool:
        """Change the force: ``weight GRAMS`` or ``force NEWTONS``."""
        match words:
            case ["weight", grams]:
                newtons = _number(grams) * GRAVITY_N_PER_G
            case ["force", force]:
                newtons = _number(force)
            case _:
                return False
        self._force_n = lambda _time_s: newtons
        return True

    def _convert(self, time_s: float) -> int:
        counts_per_n, zero, noise = self._line
        force_n = float(np.nan_to_num(self._force_n(time_s)))
        counts = zero + counts_per_n * force_n + noise * self._random.standard_normal()
        return int(np.clip(round(counts), -_LARGEST_RAW - 1, _LARGEST_RAW))


def look_at_pattern(rows: int, columns: int) -> Look:
    """Return the image function of random blocks that pass from right to left."""
    coarse = np.random.default_rng(0).integers(0, 2, (64, _PATTERN_SIDE // _BLOCK))
    pattern = np.where(np.kron(coarse, np.ones((_BLOCK, _BLOCK))), 220, 40).astype(np.uint8)

    def look(time_s: float) -> NDArray[np.uint8]:
        start = int(time_s * _PATTERN_PIXELS_S) % (_PATTERN_SIDE - columns)
        return pattern[:rows, start : start + columns]

    return look


def look_at_page(url: str, profile: Profile, rows: int, columns: int) -> Look:
    """Return the image function of a virtual finger that reads a page repeatedly."""
    kind = url.partition(":")[0]
    if kind not in ("page", "text"):
        raise SourceError(f"source {url!r}: an emulated array takes page:FILE or text:STRING")
    shape = {"sensor_rows": rows, "sensor_columns": columns}
    optics = profile.optics.model_copy(update=shape)
    source = open_source(url, profile.model_copy(update={"optics": optics}))
    lasts_ns = round(1e9 * (source.duration_s or 1.0))

    def look(time_s: float) -> NDArray[np.uint8]:
        frame = source.read(round(time_s * 1e9) % lasts_ns)
        assert isinstance(frame, Frame)
        return frame.image

    return look


def press(force_n: float, path: Path | None) -> Callable[[float], float]:
    """Return the force function of a load cell: constant, or as recorded."""
    if path is None:
        return lambda _time_s: force_n
    recorded = RecordedForce(path)
    return lambda time_s: recorded.read(round(time_s * 1e9))


def _number(word: str) -> float:
    try:
        return float(np.nan_to_num(float(word)))
    except ValueError:
        raise SourceError(f"{word!r} is no number") from None
