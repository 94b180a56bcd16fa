"""Input from a serial line: bytes as they arrive, and a load cell's readings in them.

Text is what HX711 sketches print, one reading to a line::

    HX711 reading: -8388        the library's own example
    Reading: 12.34 g
    one reading:        4.5     | average:      4.6
    0.00 kg

The first number that is not part of a word counts, so the 711 of ``HX711`` does not. A line
that ends with a colon is a label, its value comes in the next one. Text has no checksum: a
lost digit passes for a smaller number. The framed form
(`smarttouch.sources.sensor_protocol`, FORCE) has one.
"""

import contextlib
import math
import re

from smarttouch.base.errors import SourceLostError
from smarttouch.base.wire.port import LINE_ERRORS, Port, reason
from smarttouch.sources.sensor_protocol import CellReading, MessageStream

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
        raise SourceLostError(f"{title} was disconnected: {reason(error)}") from None
    return data


LONGEST_LINE = 240
LARGEST_READING = 1e9  # largest plausible reading; the converter itself ends at 8,388,607
_NUMBER = re.compile(rb"(?<![\w.+-])[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?(?![\d.])")
_NOT_A_NUMBER = re.compile(rb"(?<!\w)[+-]?(?:nan|inf|ovf)(?!\w)", re.IGNORECASE)
_TEXT = re.compile(rb"[\t\x20-\x7e]*")


def parse_line(line: bytes) -> float | None:
    """Return the reading of a line without its end; NaN if it reports none, None if it is
    invalid.
    """
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
    """Readings in lines of text.

    The first line is ignored, as it may have lost its start, and so is the first reading after
    bytes that are no text, as garbage has digits, too.
    """

    def __init__(self) -> None:
        self.garbled: int = 0
        self.last_garbled: str = ""
        self.restart()

    def restart(self) -> None:
        """Discard a partial reading: the line was interrupted."""
        self._waiting = bytearray()
        self._skipping = True
        self._in_doubt = False

    def feed(self, data: bytes) -> list[float]:
        """Return the readings of all lines completed by these bytes."""
        *whole, rest = data.replace(b"\r", b"\n").split(b"\n")
        readings: list[float] = []
        for piece in whole:
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
        """Return the reading of a whole line, if it is plausible."""
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
    """Readings in packets of the sensors' own format."""

    def __init__(self) -> None:
        self.garbled: int = 0
        self.last_garbled = "a broken packet"
        self.restart()

    def restart(self) -> None:
        """Discard a partial reading: the line was interrupted."""
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
