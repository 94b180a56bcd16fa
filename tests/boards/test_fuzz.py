"""Bytes at random, into every emulated firmware.

``SMARTTOUCH_FUZZ_BYTES=10000000 pytest tests/boards/test_fuzz.py --timeout 0`` for the long run.
"""

import os

import numpy as np
import pytest

from smarttouch.boards.link.protocol import MessageKind, encode
from smarttouch.emulator.etactilekit_firmware import ETactileKitFirmware
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware
from smarttouch.emulator.link_firmware import LinkFirmware
from smarttouch.emulator.link_packets import BoardSession

from ..whole import WHOLE
from .payloads import limits_payload, sequence_payload

BYTES = int(os.environ.get("SMARTTOUCH_FUZZ_BYTES", "50000" if WHOLE else "15000"))
MS = 1_000_000
CURRENT = np.array([[300, -100, -100, -100]], np.int16)
COLUMN = np.full(1, 100, np.uint16)
HALF, SESSION = 5, 5 << 32 | 5
PAYLOAD = sequence_payload("weighted", 5000, COLUMN, COLUMN, COLUMN * 0, CURRENT, 3, True)
SEEDS = {
    "link": [
        encode(MessageKind.HELLO, HALF, 1),
        encode(MessageKind.BEGIN, SESSION, 2),
        encode(MessageKind.STATUS, SESSION, 3),
        encode(MessageKind.LIMITS, SESSION, 4, payload=limits_payload(4)),
        encode(MessageKind.SEQUENCE, SESSION, 5, about=1, payload=PAYLOAD),
    ],
    "kajimoto61": [b"\xff" + bytes(61), b"\xff" + bytes([100] * 61), b"\xfe"],
    "etactilekit": [b"\xf5\xfc\x04\xf4", b"\xfa\x64\x00\xf7\x32\xf6\x3c\x00", b"\xfe" + bytes(8)],
}


def pieces(seed, whole):
    """Yield `BYTES` of noise, of packets, and of packets that noise has got at."""
    random = np.random.default_rng(seed)
    left = BYTES
    while left > 0:
        piece = bytearray(random.integers(0, 256, random.integers(1, 600), np.uint8).tobytes())
        if random.random() < 0.7:
            piece = bytearray(
                b"".join(whole[i] for i in random.integers(0, len(whole), random.integers(1, 8)))
            )
            for _ in range(random.integers(0, 4)):
                where = int(random.integers(len(piece)))
                if random.random() < 0.5:
                    piece[where] = int(random.integers(256))
                else:
                    del piece[where]
                    piece.append(0)
        left -= len(piece)
        yield bytes(piece)


def firmware(name):
    books = DeliveryLog({"kajimoto61": 61}.get(name, 4))
    if name == "link":
        # Always the same challenge, so that each BEGIN after a silence opens a session.
        return LinkFirmware("weighted", books, session=BoardSession(lambda: HALF), ramp_ms=0)
    if name == "kajimoto61":
        return Kajimoto61Firmware(books)
    # The newest: noise makes the others scan for too long, which they do not come back from.
    return ETactileKitFirmware(books, firmware="newest")


@pytest.mark.parametrize(
    ("name", "most_ma"),
    # The two real ones check nothing: what holds is what their firmware can ask of its source.
    [("link", 5.0), ("kajimoto61", 200 * 0.0390625), ("etactilekit", 4095 * 0.00999)],
)
def test_firmwares(name, most_ma):
    board, now = firmware(name), 0
    for piece in pieces(4, SEEDS[name]):
        now += 7 * MS
        board.feed(piece, now)
        board.advance(now + 3 * MS)
    assert board.books.max_current_ma <= most_ma * (1 + 1e-6)
    if name == "link":
        assert board.books.slots > 0
        assert board.books.unsafe == 0
    # It still listens, once it has what it waits for.
    board.feed(b"\0" * 600, now + 10 * MS)
    board.advance(now + 3000 * MS)
    question = {
        "link": SEEDS["link"][0],
        "kajimoto61": b"\xff" + bytes(61) + b"\xfe",
        "etactilekit": b"\xf5",
    }
    heard = board.feed(question[name], now + 3001 * MS)
    assert heard + board.advance(now + 3030 * MS)
