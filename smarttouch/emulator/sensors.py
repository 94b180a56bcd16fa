"""Emulated sensors: frames of an array, readings of a load cell, sent at a steady rate."""

import sys
from abc import abstractmethod

import numpy as np

from smarttouch.base.errors import BoardError
from smarttouch.emulator.firmware import DeviceClock, Firmware
from smarttouch.sources.sensor_protocol import encode_force, encode_frame

GRAVITY_N_PER_G = 9.80665e-3
_LONGEST_WAIT_S = 0.02
_BEHIND_NS = 100_000_000  # after this delay the schedule restarts, as hardware sends no burst
_BLOCK = 4
_PATTERN_SIDE = 1024
_PATTERN_PIXELS_S = 40
_SIDE = 64
COUNTS_PER_N, ZERO_COUNTS = 50_000.0, 80_000.0
_LARGEST_RAW = 2**23 - 1


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
    """A sensor array of 64 x 64 pixels under random blocks that pass from right to left."""

    def __init__(self, rate_hz: float) -> None:
        super().__init__(rate_hz)
        coarse = np.random.default_rng(0).integers(0, 2, (_SIDE // _BLOCK, _PATTERN_SIDE // _BLOCK))
        blocks = np.kron(coarse, np.ones((_BLOCK, _BLOCK)))
        self._pattern = np.where(blocks, 220, 40).astype(np.uint8)

    def packet(self, number: int, time_s: float) -> bytes:
        start = int(time_s * _PATTERN_PIXELS_S) % (_PATTERN_SIDE - _SIDE)
        image = self._pattern[:, start : start + _SIDE]
        return encode_frame(number, round(time_s * 1e6), image)


class EmulatedLoadCell(SensorFirmware):
    """A load cell with its converter under a force, N; ``noise`` is in counts. ``framed`` sends
    packets instead of lines of text."""

    def __init__(
        self, force_n: float, noise: float = 60.0, framed: bool = False, rate_hz: float = 80.0
    ) -> None:
        super().__init__(rate_hz)
        self._force_n, self._noise, self._framed = force_n, noise, framed
        self._random = np.random.default_rng(0)

    def packet(self, number: int, time_s: float) -> bytes:
        noise = self._noise * self._random.standard_normal()
        counts = round(ZERO_COUNTS + COUNTS_PER_N * self._force_n + noise)
        reading = min(max(counts, -_LARGEST_RAW - 1), _LARGEST_RAW)
        if self._framed:
            return encode_force(number, round(time_s * 1e6), reading)
        return f"HX711 reading: {reading}\r\n".encode()

    def take_order(self, order: str) -> None:
        """Change the force: ``weight GRAMS`` or ``force NEWTONS``."""
        what, _, number = order.partition(" ")
        try:
            newtons = float(number) * {"weight": GRAVITY_N_PER_G, "force": 1.0}[what]
            self._force_n = float(np.nan_to_num(newtons))
        except (KeyError, ValueError):
            raise BoardError(
                f"{order!r} is no order: write weight GRAMS or force NEWTONS"
            ) from None
