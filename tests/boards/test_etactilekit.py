"""To the byte: what an eTactileKit hears, and that no change is trusted without its echo."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.boards import etactilekit
from smarttouch.boards.etactilekit import ETactileKitBoard
from smarttouch.boards.probe import one_each
from smarttouch.errors import BoardError, LineLostError
from smarttouch.profile.device import Output
from smarttouch.scan.safety import SafetyLimits

LIMITS = SafetyLimits(4, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0)
QUIET, PING, ON = b"\xfb\x02", b"\xf4", b"\xfb\x00"
NOTHING = b"\xfe" + bytes(8)
ZERO = [(QUIET + NOTHING + PING, b"\x04"), (ON, b"")]
ZEROS = (bytes(514), b"")
HELLO = [ZEROS, (b"\xf5", b"\x01"), (b"\xf9\0\0\xf8\0\0\xfc\x04" + PING, b"\x04")]
PINGS = [(PING, b"\x04")] * 3
OPEN = [*HELLO, *ZERO, *PINGS]


def settings(width=100, discharge=50, rate=50, anodic=1):
    end = bytes(3)
    once = (
        QUIET + end + b"\xf9\0" + end + b"\xf8\0" + end + bytes([0xFD, anodic]) + end
        + b"\xfa" + bytes([width, 0]) + end + bytes([0xF7, discharge]) + end
        + b"\xf6" + bytes([rate, 0]) + end
    )  # fmt: skip
    return (QUIET + NOTHING + once * 2 + PING, b"\x04")


def heights(*counts):
    return b"\xfe" + b"".join(count.to_bytes(2, "little") for count in counts)


def anodic(level_ua, step=1, sites=(1,), cathodic=False, width=100, period_us=20_000):
    return one_each(
        LIMITS, level_ua, width, float(level_ua > 0), step * 10**9, cathodic=cathodic,
        sites=list(sites), discharge_us=50, period_us=period_us,
    )  # fmt: skip


def send(board, *sequences):
    for sequence in sequences:
        board.send(sequence)
        board.drain()


def test_a_run_to_the_byte(script):
    # 220 counts at 9.99 µA, as in the board's own example; the voltages are those of the
    # pattern before, so the first change does not ask for any.
    readings = b"\0\0\xd0\x07\0\0\0\0"
    script(
        *OPEN,
        settings(),
        (QUIET + heights(0, 220, 0, 0) + PING, b"\x04"),
        (ON, b""),
        (b"\xff" + QUIET + heights(0, 110, 110, 0) + PING, readings + b"\x04"),
        (ON, b""),
        (b"\xff" + QUIET + NOTHING + PING, bytes(8) + b"\x04"),
        (ON, b""),
    )
    with ETactileKitBoard("x", LIMITS) as board:
        send(board, anodic(0, 0), anodic(2200), anodic(1100, 2, (1, 2)))
        ((sequence, volts),) = board.take_volts()
        assert sequence.site.tolist() == [1]
        assert volts == pytest.approx([2000 * 0.0893])
        assert (board.acknowledged, board.refused) == (3, 0)


@pytest.mark.parametrize(("share", "lifted"), [(1.0, True), (0.7, False)])
def test_a_finger_that_is_gone_is_known_by_the_load_beside_it(script, share, lifted):
    # 2,000 µA through 66 kOhm alone are 132 V.
    reading = int(share * 2 * 66 / 0.0893).to_bytes(2, "little")
    script(
        *OPEN,
        settings(),
        (QUIET + heights(0, 200, 0, 0) + PING, b"\x04"),
        (ON, b""),
        (b"\xff" + QUIET + NOTHING + PING, b"\0\0" + reading + bytes(4) + b"\x04"),
        (ON, b""),
    )
    with ETactileKitBoard("x", LIMITS) as board:
        send(board, anodic(0, 0), anodic(2000))
    assert board.lifted == lifted


def test_only_changes_are_sent(script):
    script(
        *OPEN,
        settings(),
        (QUIET + heights(0, 100, 0, 0) + PING, b"\x04"),
        (ON, b""),
        (b"\xff" + QUIET + NOTHING + PING, bytes(8) + b"\x04"),
        (ON, b""),
    )
    with ETactileKitBoard("x", LIMITS) as board:
        send(board, anodic(0, 0), *(anodic(1000, step) for step in range(1, 6)))
        assert board.acknowledged == 6


def test_another_polarity_is_set_while_nothing_flows(script):
    script(
        *OPEN,
        settings(),
        (QUIET + heights(0, 100, 0, 0) + PING, b"\x04"),
        (ON, b""),
        settings(anodic=0),
        (b"\xff" + QUIET + heights(0, 100, 0, 0) + PING, bytes(8) + b"\x04"),
        (ON, b""),
        (b"\xff" + QUIET + NOTHING + PING, bytes(8) + b"\x04"),
        (ON, b""),
    )
    with ETactileKitBoard("x", LIMITS) as board:
        send(board, anodic(0, 0), anodic(1000), anodic(1000, 2, cathodic=True))


def test_wiring_puts_each_electrode_on_its_output(script):
    output = Output(kind="one-against-all", wiring=(5, 3, 0, 1))
    hello = [ZEROS, (b"\xf5", b"\x01"), (b"\xf9\0\0\xf8\0\0\xfc\x06" + PING, b"\x06")]
    nothing = (QUIET + b"\xfe" + bytes(12) + PING, b"\x06")
    script(
        *hello,
        nothing,
        (ON, b""),
        *[(PING, b"\x06")] * 3,
        (settings()[0].replace(NOTHING, b"\xfe" + bytes(12)), b"\x06"),
        (QUIET + heights(0, 0, 0, 100, 0, 0) + PING, b"\x06"),
        (ON, b""),
        (b"\xff" + nothing[0], bytes(12) + b"\x06"),
        (ON, b""),
    )
    with ETactileKitBoard("x", LIMITS, output) as board:
        send(board, anodic(0, 0), anodic(1000))


def test_a_lost_echo_brings_no_current_and_the_next_frame_goes_on(script, monkeypatch):
    monkeypatch.setattr(etactilekit, "FORGETS_S", 0.05)
    fresh = [ZEROS, (QUIET + bytes(4) + PING, b"\x04")]
    script(
        *OPEN,
        settings(),
        (QUIET + heights(0, 100, 0, 0) + PING, b""),
        *fresh,
        (QUIET + heights(0, 101, 0, 0) + PING, b"\x04"),
        (ON, b""),
        (b"\xff" + QUIET + NOTHING + PING, bytes(8) + b"\x04"),
        (ON, b""),
    )
    with ETactileKitBoard("x", LIMITS) as board:
        send(board, anodic(0, 0), anodic(1000), anodic(1010, 2))
        assert (board.acknowledged, board.refused) == (2, 1)


def test_a_board_that_never_echoes_again_is_told_of(script, monkeypatch):
    monkeypatch.setattr(etactilekit, "FORGETS_S", 0.05)
    ping = (QUIET + bytes(4) + PING, b"")
    silent = [ZEROS, ping, ping]
    lost = (QUIET + NOTHING + PING, b"")
    script(
        *OPEN, settings(), (QUIET + heights(0, 100, 0, 0) + PING, b""), *silent, lost, *silent,
    )  # fmt: skip
    board = ETactileKitBoard("x", LIMITS)
    board.open()
    send(board, anodic(0, 0), anodic(1000))
    # Even if nothing is sent any more: its last pattern may still be running.
    with pytest.raises(LineLostError, match=r"not echo any more.*goes on with its last pattern"):
        board.close()


def test_settings_that_were_not_confirmed_are_set_again(script):
    script(
        *OPEN,
        settings(),
        (QUIET + heights(0, 100, 0, 0) + PING, b"\x04"),
        (ON, b""),
        (settings(anodic=0)[0], b""),
        ZEROS,
        (QUIET + bytes(4) + PING, b"\x04"),
        # What of the cathodic ones has arrived, nobody knows: the anodic ones go out again.
        settings(),
        (QUIET + heights(0, 101, 0, 0) + PING, b"\x04"),
        (ON, b""),
        (b"\xff" + QUIET + NOTHING + PING, bytes(8) + b"\x04"),
        (ON, b""),
    )
    with ETactileKitBoard("x", LIMITS) as board:
        send(board, anodic(0, 0), anodic(1000), anodic(1000, 2, cathodic=True), anodic(1010, 3))
        assert (board.acknowledged, board.refused) == (3, 1)


@pytest.mark.parametrize(
    ("exchanges", "says"),
    [
        ([ZEROS, (b"\xf5", b""), (b"\xf5", b"")], "not answer as an eTactileKit v2"),
        ([*HELLO[:2], (HELLO[2][0], b"")], "does not echo"),
        ([*HELLO[:2], (HELLO[2][0], b"\x05")], "does not echo"),
    ],
)
def test_another_variant_is_refused_before_any_pattern(script, monkeypatch, exchanges, says):
    monkeypatch.setattr(etactilekit, "FORGETS_S", 0.0)
    script(*exchanges)
    with pytest.raises(BoardError, match=says):
        ETactileKitBoard("x", LIMITS).open()


def test_a_smaller_kit_than_the_profile_is_refused(script):
    script(*HELLO[:2])
    limits = SafetyLimits(32, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0)
    with pytest.raises(BoardError, match="8 outputs, the profile needs 32"):
        ETactileKitBoard("x", limits).open()


def test_a_measurement_takes_the_dummy_load_off(script):
    # 0.999 mA at 50 µs; 200 counts are 17.9 V, of which 17.9 V / 66 kΩ pass beside the skin.
    ask = (
        QUIET + b"\xfd\x01\xf7\x64\xf6\x0a\0" + bytes([0xF8, 50, 0xF9, 100])
        + b"\xff\xf9\0\0\xf8\0\0" + PING
    )  # fmt: skip
    readings = b"\xc8\0\xc8\0\xff\x0f\x02\0"
    script(*OPEN, *ZERO, (ask, readings + b"\x04"), *ZERO, *ZERO)
    with ETactileKitBoard("x", LIMITS) as board:
        found = board.measure()
    volts = 200 * 0.0893
    total = volts / (0.999 - volts / 66)
    assert found.condition == ("good", "good", "open", "short")
    # Between the two good ones: what one sees of the other lies in the return.
    assert found.kohm[0] == pytest.approx(total - found.kohm[3], rel=0.05)


def test_slow_writes_are_pieces_of_eight(script, monkeypatch):
    pauses = []
    monkeypatch.setattr(etactilekit.time, "sleep", pauses.append)
    port = script(*OPEN, *ZERO)
    sizes, write = [], port.write
    port.write = lambda data: (sizes.append(len(data)), write(data))[1]
    with ETactileKitBoard("x?slow", LIMITS):
        pass
    assert max(sizes) == 8
    assert pauses.count(0.003) >= 4


def test_an_unknown_option_is_named():
    with pytest.raises(BoardError, match=r"knows the option \?slow, not \?fast"):
        ETactileKitBoard("x?fast", LIMITS)


@pytest.mark.parametrize("mixed", ["polarity", "width"])
def test_what_it_has_only_one_of_is_refused(mixed):
    board = ETactileKitBoard("x", LIMITS)
    sequence = anodic(1000, sites=(1, 2))
    if mixed == "polarity":
        sequence.current_ua[1] *= -1
    else:
        sequence.width_us[1] = 90
    with pytest.raises(BoardError, match=r"one polarity|one pulse width"):
        board._encode(sequence)


@given(levels=st.lists(st.integers(0, 5000), min_size=4, max_size=4))
def test_no_byte_of_a_pattern_looks_like_a_command(levels):
    board = ETactileKitBoard("x", LIMITS)
    for site, level in enumerate(levels):
        data = board._encode(anodic(level, sites=(site,)))
        assert max(data) < 0xF4
        counts = np.frombuffer(data, "<u2")
        assert counts.max() <= 500
        assert level - 9.99 * counts.max() <= max(6, 12 * 9.99 + 6)
