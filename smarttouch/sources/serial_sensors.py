"""Sensor arrays and load cells on serial lines, with the specification of their wire format.

The device streams over a USB or other serial line; the host sends nothing. A packet is COBS-encoded
and ends with one 0x00, so receivers resynchronize at the next zero. The decoded packet is little
endian::

    u8  version = 1
    u8  type
    u32 number      counts the packets of its type from 0 on and wraps; a gap
                    gives the number of lost packets
    ... payload
    u32 CRC-32      (IEEE 802.3) of all bytes before the CRC

==== ===== ==================================================================
type name  payload
==== ===== ==================================================================
0x41 FRAME u8 rows H, u8 columns W, u32 device time µs, u8 pixels [H][W]: row
           by row from the top left, 0 black to 255 white, as seen on the page
0x42 FORCE i32 reading of the load cell, u32 device time µs; the reading
           −2147483648 means that the device has no value
==== ===== ==================================================================

Rules for the device:

- It sends each FRAME immediately and never queues frames. A frame that cannot be sent in time is
  dropped, and its number is skipped.
- Device time is the time of capture, on a clock that does not stop; it wraps after 71.6 minutes.
  The host measures the age of a frame from the arrival.
- A device with an image sensor and a load cell may send both over one line. Other types of packets
  are ignored.

A FRAME of 64 × 64 pixels has up to 4,130 bytes. At 200 frames a second, this is 826 kB/s, which USB
can carry. At 921,600 baud, a line carries 22 frames a second of 64 × 64 pixels, 88 of 32 × 32, 335
of 16 × 16 and 2,700 of 4 × 4.

Sketches for the HX711 print text, one reading per line::

    HX711 reading: -8388        the library's own example
    Reading: 12.34 g
    one reading:        4.5     | average:      4.6
    0.00 kg

The reading is the first number that is not part of a word such as ``HX711``. A line that ends with
a colon is a label for the value in the next line. Text has no checksum, unlike FORCE packets: a
lost digit is not detected."""

import contextlib
import math
import re
import struct
import time
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SourceError, SourceLostError
from smarttouch.base.wire.framing import Deframer, WirePacket, frame_packet
from smarttouch.base.wire.port import LINE_ERRORS, Port, open_port, reason
from smarttouch.profile import Profile
from smarttouch.sources.live_capture import ImageDevice, LiveSource, Shot
from smarttouch.sources.source_contract import DeviceWarnings

VERSION = 1
MOST_PIXELS_A_SIDE = 255
NO_READING = -(2**31)
LARGEST_BODY = MOST_PIXELS_A_SIDE**2 + 16  # largest packet with head and CRC, bytes
NUMBERS = 2**32

_FRAME = struct.Struct("<BBI")
_FORCE = struct.Struct("<iI")


class PacketKind(IntEnum):
    FRAME = 0x41
    FORCE = 0x42


@dataclass(frozen=True, eq=False)
class ArrayFrame:
    """Frame of a sensor array. The image is read-only. Number and device time are modulo 2³²."""

    number: int
    time_us: int
    image: NDArray[np.uint8]


@dataclass(frozen=True)
class CellReading:
    """Reading of a load cell in counts; None if the device has no value."""

    number: int
    time_us: int
    reading: int | None


Message = ArrayFrame | CellReading


def encode_frame(number: int, time_us: int, image: NDArray[np.uint8]) -> bytes:
    """Encode a frame, (H, W) uint8 with 1 to 255 rows and columns."""
    if image.ndim != 2 or image.dtype != np.uint8:
        raise SourceError(
            f"an image of {image.dtype} {image.shape} is not a frame: give gray levels (H, W) uint8"
        )
    rows, columns = image.shape
    if not (1 <= rows <= MOST_PIXELS_A_SIDE and 1 <= columns <= MOST_PIXELS_A_SIDE):
        raise SourceError(
            f"an image of {rows} x {columns} pixels is not a frame: give 1 to {MOST_PIXELS_A_SIDE} "
            "rows and columns"
        )
    head = _FRAME.pack(rows, columns, time_us % NUMBERS)
    return frame_packet(VERSION, PacketKind.FRAME, number % NUMBERS, head + image.tobytes())


def encode_force(number: int, time_us: int, reading: int | None) -> bytes:
    """Encode a reading of a load cell."""
    value = NO_READING if reading is None else reading
    if not NO_READING <= value < 2**31:
        raise SourceError(f"reading {value} does not fit 32 bits: scale it down")
    payload = _FORCE.pack(value, time_us % NUMBERS)
    return frame_packet(VERSION, PacketKind.FORCE, number % NUMBERS, payload)


def decode(packet: WirePacket) -> Message | None:
    """Return the message in a packet; None if the packet is malformed, or has an unknown kind or
    version."""
    if packet.version != VERSION:
        return None
    if packet.kind == PacketKind.FRAME:
        return _decode_frame(packet.number, packet.payload)
    if packet.kind == PacketKind.FORCE and len(packet.payload) == _FORCE.size:
        value, time_us = _FORCE.unpack(packet.payload)
        return CellReading(packet.number, time_us, None if value == NO_READING else value)
    return None


def _decode_frame(number: int, payload: bytes) -> ArrayFrame | None:
    if len(payload) < _FRAME.size:
        return None
    rows, columns, time_us = _FRAME.unpack_from(payload)
    if not rows * columns or len(payload) != _FRAME.size + rows * columns:
        return None
    pixels = np.frombuffer(payload, np.uint8, offset=_FRAME.size)
    return ArrayFrame(number, time_us, pixels.reshape(rows, columns))


def gap(before: int, number: int) -> int:
    """Return the number of packets lost between two packet numbers. Return 0 if the second packet
    is older, or if the device has restarted."""
    missing = (number - before - 1) % NUMBERS
    return missing if missing < NUMBERS // 2 else 0


class MessageStream:
    """Parser of messages in a stream that may start within a message.

    ``broken`` is the number of malformed packets. It does not count the first packet, whose start
    can be missing. Packets of unknown kinds are ignored."""

    def __init__(self) -> None:
        self.broken: int = 0
        self._deframer = Deframer(LARGEST_BODY)
        self._begun = False

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that these bytes complete."""
        messages: list[Message] = []
        before = self._deframer.errors
        for packet in self._deframer.feed(data):
            self._begin()
            message = decode(packet)
            if message is not None:
                messages.append(message)
            elif packet.version != VERSION or packet.kind in set(PacketKind):
                self.broken += 1
        if self._deframer.errors > before:
            self._begin()
        self.broken += self._deframer.errors - before
        return messages

    def _begin(self) -> None:
        if not self._begun:
            self.broken -= min(1, self._deframer.errors)
            self._begun = True


_LARGEST_READ = 65536


def read_available(port: Port, title: str) -> bytes:
    """Return the received bytes; wait for the first byte up to the port's timeout."""
    try:
        # A request for more bytes than have arrived would wait for the timeout.
        data = bytes(port.read(port.in_waiting or 1))
        # For TCP, pyserial does not report how many bytes have arrived: read them from the socket.
        wire = getattr(port, "_socket", None)
        if data and wire is not None:
            with contextlib.suppress(BlockingIOError):
                data += wire.recv(_LARGEST_READ)
    except LINE_ERRORS as error:
        raise SourceLostError(f"{title} was disconnected: {reason(error)}") from None
    return data


LONGEST_LINE = 240
LARGEST_READING = 1e9  # largest plausible reading; the converter's range ends at 8,388,607
_NUMBER = re.compile(rb"(?<![\w.+-])[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?(?![\d.])")
_NOT_A_NUMBER = re.compile(rb"(?<!\w)[+-]?(?:nan|inf|ovf)(?!\w)", re.IGNORECASE)
_TEXT = re.compile(rb"[\t\x20-\x7e]*")


def parse_line(line: bytes) -> float | None:
    """Return the reading in ``line``, which has no line ending. Return NaN if the line states NaN,
    overflow or an implausible number. Return None if it has no number or is not text."""
    if not _TEXT.fullmatch(line):
        return None
    number, none = _NUMBER.search(line), _NOT_A_NUMBER.search(line)
    if none is not None and (number is None or none.start() < number.start()):
        return math.nan
    if number is None:
        return None
    value = float(number[0])
    return value if abs(value) <= LARGEST_READING else math.nan


class TextReadings:
    """Parser of readings in lines of text.

    It ignores the first line, whose start can be missing. It also ignores the first reading after
    bytes that are not text, because noise can contain digits."""

    def __init__(self) -> None:
        self.garbled: int = 0
        self.last_garbled: str = ""
        self.restart()

    def restart(self) -> None:
        """Discard a partial reading after an interruption of the connection."""
        self._waiting = bytearray()
        self._skipping = True
        self._in_doubt = False

    def feed(self, data: bytes) -> list[float]:
        """Return the readings of all lines completed by these bytes."""
        *lines, rest = data.replace(b"\r", b"\n").split(b"\n")
        readings: list[float] = []
        for piece in lines:
            line = bytes(self._waiting) + piece
            self._waiting.clear()
            skipped, self._skipping = self._skipping, False
            if not skipped:
                readings += self._read(line)
        self._waiting += rest
        if len(self._waiting) > LONGEST_LINE:
            if not self._skipping:
                self._count(bytes(self._waiting))
                self._in_doubt = True
            self._waiting.clear()
            self._skipping = True
        return readings

    def _read(self, line: bytes) -> list[float]:
        """Return a list with the reading of a line; it is empty if the reading is not reliable."""
        line = line.strip()
        if not line or (line.endswith(b":") and _TEXT.fullmatch(line)):
            return []
        reading = parse_line(line)
        if reading is None:
            self._in_doubt = self._in_doubt or not _TEXT.fullmatch(line)
            self._count(line)
            return []
        doubted, self._in_doubt = self._in_doubt, False
        return [] if doubted else [reading]

    def _count(self, line: bytes) -> None:
        self.garbled += 1
        self.last_garbled = ascii(line[:40].decode("latin-1"))


class PacketReadings:
    """Parser of readings in FORCE packets."""

    def __init__(self) -> None:
        self.garbled: int = 0
        self.last_garbled = "a broken packet"
        self.restart()

    def restart(self) -> None:
        """Discard a partial reading after an interruption of the connection."""
        self._stream = MessageStream()

    def feed(self, data: bytes) -> list[float]:
        """Return the readings of all packets completed by these bytes."""
        before = self._stream.broken
        values = [
            message.reading
            for message in self._stream.feed(data)
            if isinstance(message, CellReading)
        ]
        self.garbled += self._stream.broken - before
        return [math.nan if value is None else float(value) for value in values]


USUAL_BAUD = 921_600  # default speed of a serial line; it has no effect on USB devices
_WAIT_S = 0.05  # longest single read
_UNREADABLE_S = 1.5
"""If a device sends bytes, but no valid frame within this time, it is not a sensor array."""


def open_serial_array(rest: str, profile: Profile, *, baud: int | None = None) -> LiveSource:
    """Open ``serial-array:PORT``. The port is a device, ``tcp://HOST:PORT`` or a pyserial URL."""
    if not rest:
        raise SourceError("'serial-array:' has no port: give one, as in serial-array:/dev/ttyACM0")
    if baud is not None and baud < 1:
        raise SourceError(f"{baud} baud is not a line speed: give bits per second, as in 115200")
    return LiveSource(SerialArrayDevice(rest, USUAL_BAUD if baud is None else baud), profile)


class SerialArrayDevice(ImageDevice):
    """Sensor array on a serial line, with counts of complete and lost frames and of bad packets."""

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
        """Open the port. The first `grab` discards all bytes that have arrived before it."""
        self._port = open_port(self._name, self._baud, _WAIT_S, SourceError)
        self._listening_since_ns = None

    def grab(self, timeout_s: float) -> Shot | None:
        """Read until a frame is complete, and return the newest one; None after ``timeout_s``."""
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
            # Ignore a failure here: it recurs in the first read, which reports it.
            port.reset_input_buffer()
        self._stream = MessageStream()
        # Frames sent before the port was opened do not count as lost.
        self._before = None
        self._listening_since_ns = time.perf_counter_ns()

    def _take(self, data: bytes) -> Shot | None:
        """Return the newest frame that these bytes complete, or None if they complete no frame."""
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
        """Raise SourceError if bytes, but no frame, have arrived within `_UNREADABLE_S`."""
        assert self._listening_since_ns is not None
        listened_s = (time.perf_counter_ns() - self._listening_since_ns) / 1e9
        if self._received and not self.frames and listened_s > _UNREADABLE_S:
            raise SourceError(
                f"{self._name} sends no frames: check its speed (now "
                f"{self._baud} baud) and that the device sends the format of "
                "smarttouch/sources/serial_sensors.py"
            )
