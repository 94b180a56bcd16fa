"""``serial-array:PORT``: a patch of photo-transistors or an optical-mouse sensor on a serial line.

The device streams frames of up to 255 × 255 pixels in the format of
`smarttouch.sources.sensor_protocol`. Of several frames that
arrive together the newest is taken and the others are counted.
"""

import contextlib
import time

from smarttouch.base.errors import SourceError
from smarttouch.base.wire.port import LINE_ERRORS, Port, open_port
from smarttouch.profile import Profile
from smarttouch.sources.live_capture import ImageDevice, LiveSource, Shot
from smarttouch.sources.sensor_protocol import ArrayFrame, MessageStream, gap, read_available
from smarttouch.sources.source_contract import DeviceWarnings

USUAL_BAUD = 921_600  # default speed of lines that have one; over USB it has no effect
_WAIT_S = 0.05  # longest single read
_UNREADABLE_S = 1.5
"""Time without a valid frame from the start, after which the device is no sensor."""


def open_serial_array(rest: str, profile: Profile, *, baud: int | None = None) -> LiveSource:
    """Open ``serial-array:PORT``: a device, ``tcp://HOST:PORT``, or any URL that pyserial knows."""
    if not rest:
        raise SourceError("serial-array: has no port: give one, as in serial-array:/dev/ttyACM0")
    if baud is not None and baud < 1:
        raise SourceError(f"{baud} baud is not a line speed: give bits per second, as in 115200")
    return LiveSource(SerialArrayDevice(rest, USUAL_BAUD if baud is None else baud), profile)


class SerialArrayDevice(ImageDevice):
    """Frames from a serial line, with counts of complete and lost ones and of garbled pieces."""

    def __init__(self, port: str, baud: int = USUAL_BAUD) -> None:
        self.title: str = f"serial array {port}"
        self.frames: int = 0
        self.lost: int = 0
        self.garbled: int = 0
        self._name, self._baud = port, baud
        self._port: Port | None = None
        self._stream = MessageStream()
        self._before: int | None = None
        self._received = 0
        self._listening_since_ns: int | None = None
        self._warnings = DeviceWarnings(self.notes)

    def open(self) -> None:
        """Open the port. Earlier bytes are discarded at the first `grab`."""
        self._port = open_port(self._name, self._baud, _WAIT_S, SourceError)
        self._listening_since_ns = None

    def grab(self, timeout_s: float) -> Shot | None:
        """Return the newest frame of the next read that has any; None at the time limit."""
        port = self._port
        assert port is not None
        if self._listening_since_ns is None:
            self._begin(port)
        deadline = time.monotonic() + timeout_s
        while True:
            shot = self._take(read_available(port, self.title))
            if shot is not None:
                return shot
            if time.monotonic() >= deadline:
                self._require_frames()
                return None

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            with contextlib.suppress(*LINE_ERRORS):
                self._port.close()
        self._port = None

    def _begin(self, port: Port) -> None:
        with contextlib.suppress(*LINE_ERRORS):
            # A failure here occurs again in the first read.
            port.reset_input_buffer()
        self._stream = MessageStream()
        # Frames sent before the port was opened do not count as lost.
        self._before = None
        self._listening_since_ns = time.perf_counter_ns()

    def _take(self, data: bytes) -> Shot | None:
        """Return the newest of the frames completed by these bytes."""
        self._received += len(data)
        newest, frames, broken = None, 0, self._stream.broken
        for message in self._stream.feed(data):
            if isinstance(message, ArrayFrame):
                newest = message
                frames += 1
                self.lost += 0 if self._before is None else gap(self._before, message.number)
                self._before = message.number
            # Force readings on the same line are ignored here.
        self.frames += frames
        self.garbled += self._stream.broken - broken
        self._note("lost", self.lost, "frames lost on the line")
        self._note("garbled", self.garbled * bool(self.frames), "unreadable pieces of the input")
        if newest is None:
            return None
        return Shot(newest.image, time.perf_counter_ns(), frames - 1)

    def _note(self, cause: str, count: int, words: str) -> None:
        if count:
            self._warnings.put(cause, f"{self.title}: {words}: {count}")

    def _require_frames(self) -> None:
        """Raise if bytes have arrived for a while, and never a frame."""
        assert self._listening_since_ns is not None
        listened_s = (time.perf_counter_ns() - self._listening_since_ns) / 1e9
        if self._received and not self.frames and listened_s > _UNREADABLE_S:
            raise SourceError(
                f"{self._name} sends no frames: check its speed (now "
                f"{self._baud} baud) and that the device sends the format of "
                "smarttouch/sources/sensor_protocol.py"
            )
