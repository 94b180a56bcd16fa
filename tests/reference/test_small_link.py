"""The page on the link is enough: what was written from it works with what is here."""

import itertools
import json
from pathlib import Path

import pytest

from smarttouch.emulator.link_firmware import LinkFirmware
from smarttouch.emulator.rules_over_time import Room
from tests.firmware.judge import Limits
from tests.firmware.rig import Emulated, PulseBooks
from tests.reference.small_board import Board
from tests.reference.small_link import ACK, NAK, STATUS, STOP, STOPPED, Client

VECTORS = json.loads(
    (Path(__file__).parents[1] / "firmware" / "vectors.json").read_text(encoding="utf-8")
)


@pytest.mark.parametrize("name", VECTORS)
def test_a_board_from_the_page_alone_passes_the_vectors(name):
    vector = VECTORS[name]
    board = Board(vector["ramp_ms"])
    for step in vector["steps"]:
        if "bytes" in step:
            now = bytes.fromhex(step["bytes"]), step["time_us"]
            answer, pulses = board.feed(*now, step.get("measured", ()))
        else:
            answer, pulses = board.advance(step["time_us"], step.get("measured", ()))
        assert (answer.hex(), pulses) == (step["answer"], step["pulses"])


def _emulated(room):
    made = Emulated(4)
    books = made._books
    assert isinstance(books, PulseBooks)
    made._board = LinkFirmware(4, "weighted", books, ramp_ms=500, room=Room(*room))
    return made


@pytest.mark.parametrize("room", [(4096, 1 << 20), (4, 128)], ids=["large", "small"])
@pytest.mark.parametrize("make", [lambda room: Board(500, *room), _emulated], ids=["small", "ours"])
def test_a_client_from_the_page_alone_drives_both_boards(make, room):
    board, now_us, pulses = make(room), 0, []

    def exchange(data):
        answer, some = board.feed(data, now_us)
        pulses.extend(some)
        return answer

    def wait():
        nonlocal now_us
        now_us += 400
        answer, some = board.advance(now_us)
        pulses.extend(some)
        return answer

    client = Client(exchange)
    client.open(Limits().payload())
    slots = [
        (100, 50, k % 4, [(3 if e == k % 4 else -1) * 40 for e in range(4)]) for k in range(10)
    ]
    for _ in range(4):
        assert set(client.send(20_000, 2000, slots, wait)) == {ACK}
    # More than the stated intensity allows.
    loud = [(100, 50, 0, [3000, -1000, -1000, -1000])]
    assert client.send(20_000, 2000, loud, wait) == [NAK]
    while len(pulses) < 4 * len(slots):
        client.take(wait())
    assert client.alive > 0
    ((_, _, report),) = [each for each in client.ask(STATUS) if len(each[2]) == 53]
    assert [kind for kind, *_ in client.ask(STOP)] == [STOPPED]
    assert [(pulse[3], pulse[2], pulse[5]) for pulse in pulses] == [
        (100, site, ua) for _, _, site, ua in 4 * slots
    ]
    starts = [pulse[4] for pulse in pulses]
    assert all(b - a >= 150 for a, b in itertools.pairwise(starts))
    assert int.from_bytes(report[:4], "little") in (3, 4)
