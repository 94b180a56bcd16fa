"""The tests of `DriverContract`, for each kind of board."""

import time
from dataclasses import replace

import numpy as np
import pytest

from firmware.tests.random_histories import random_table
from smarttouch.base.errors import BoardError, BoardRestartedError
from smarttouch.boards.board import Board
from smarttouch.boards.driver import Line
from smarttouch.boards.kits.etactilekit_protocol import zero_anywhere
from smarttouch.boards.link import Rule
from smarttouch.boards.open import make_board
from smarttouch.emulator.drivers import SimulatedDriver
from smarttouch.emulator.etactilekit_firmware import ETactileKitFirmware
from smarttouch.emulator.firmware_base import DeliveryLog, read_slots, read_state
from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware
from smarttouch.emulator.link_board_limits import BrokenRule, LinkRules
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.probe_scans import probe_sequences
from smarttouch.testing.driver_contract import (
    LATE_NS,
    DriverContract,
    SentPulse,
    planned_pulses,
)
from tests.boards.emulator_waits import deliver, fresh_state, until

from ..support.checks import raises
from ..support.full import WHOLE


def decoded(written, firmware, extra_us=0):
    """Return the pulses that a kit's emulated firmware delivers for (time_ns, bytes) pairs.

    After each pulse the firmware rests ``extra_us`` longer than requested.
    """
    found = []

    def pulse(
        number, electrode, current_ua, width_us, start_ns, *, among, rest_us, more=False, **_
    ):
        # Without skin, the other electrodes share the return current equally.
        current = [-current_ua / (among - 1)] * among
        current[electrode] = current_ua
        # With ``more``, the current is left from the self-test and is not part of the pulse.
        if current_ua and not more:
            found.append(SentPulse(tuple(current), width_us, rest_us - extra_us))
        return 0

    firmware._pulse = pulse
    for time_ns, data in written:
        firmware.feed(data, time_ns)
    firmware.advance(time.monotonic_ns())
    return found


def pulses_in_books(folder):
    """Return the pulses in the delivery log of an emulated link board."""
    slots = np.concatenate([read_slots(folder), read_slots(folder, recharges=True)])
    slots = slots[np.argsort(slots["time_us"], kind="stable")]
    found = []
    for number, slot in enumerate(slots):
        current_ua = slot["current_ua"].astype(float)
        strongest = np.abs(current_ua).argmax()
        width_us = round(1e6 * float(slot["charge_uc"][strongest] / current_ua[strongest]), 3)
        discharge_us = None
        if number + 1 < len(slots) and slots[number + 1]["slot"] == int(slot["slot"]) + 1:
            discharge_us = float(slots[number + 1]["time_us"] - slot["time_us"]) - width_us
        found.append(SentPulse(tuple(current_ua), width_us, discharge_us))
    return found


DIFFERS = {
    "test_a_stop_at_any_line_of_the_driver", "test_closing_puts_it_at_zero",
    "test_what_the_device_is_sent_is_what_was_proved", "test_a_newer_sequence_ends_a_repetition",
}  # fmt: skip


def without_repeating(kind):
    """Decorate the tests of a board that is a variant of another. Without ``pytest --full``, run
    only the tests in `DIFFERS` and those that the decorated class defines."""
    for name in dir(kind):
        if name.startswith("test_") and name not in {*DIFFERS, *vars(kind)} and not WHOLE:
            setattr(kind, name, None)
    return kind


class Contract(DriverContract):
    """The contract of drivers, checked with the delivery log of an emulator.

    Subclasses have a fixture `url`, and attributes that state the abilities of their boards.
    """

    output_kind = "weighted"
    # The largest intensity that the ramp allows directly after zero.
    intensity, level_ua = 0.2, 480
    # Number of lines of the driver at which a stop is tested.
    instants = 8 if WHOLE else 2

    @pytest.fixture
    def make_board(self, url, limits):
        def make(url=url):
            return self.board(self.make_driver(limits, url), limits)

        self.url = url
        return make

    @pytest.fixture(autouse=True)
    def _given(self, tmp_path, make_board):
        self.folder, self.make = tmp_path, lambda limits: self.make_driver(limits)

    def make_driver(self, limits, url=None):
        url = url or self.url
        polarities = ("anodic", "cathodic") if self.cathodic else ("anodic",)
        self.output = Output(kind=self.output_kind, polarities=polarities)
        options = {"books": self.folder} if url == "emulator:" else {}
        here = url(self.output.kind) if callable(url) else url
        self.driver = make_board(here, limits, self.output, **options).driver
        return self.driver

    def board(self, driver, limits):
        return Board(
            driver, limits, self.output, on_a_finger=False, claimed_time=True, late_ns=LATE_NS,
            simulated_time=type(driver) is SimulatedDriver,
        )  # fmt: skip

    def state(self):
        process = getattr(self.driver, "process", None)
        ended = process is not None and process.has_ended
        state = read_state(self.folder) if ended else fresh_state(self.folder)
        assert (state["violations"], state["unsafe"]) == (0, 0)
        return state

    def pulses(self):
        self.state()
        return pulses_in_books(self.folder)

    def assert_silent(self):
        """Assert that all electrodes are shorted, and stay shorted."""
        before = self.state()
        assert before["state"] == "shorted"
        assert self.state()["slots"] == before["slots"]

    def test_a_newer_sequence_ends_a_repetition(self, make_board):
        with make_board() as board:
            deliver(board, self.sequence(0))
            board.send(self.sequence(1), times=1000)
            until(lambda: read_state(self.folder)["slots"] >= 4)
            board.send(self.sequence(2, sites=[5]))
            until(lambda: read_slots(self.folder)["site"][-1] == 5)
        assert self.state()["slots"] < 2000


@pytest.mark.realtime
class TestEmulator(Contract):
    @pytest.fixture
    def url(self):
        return "emulator:"


@pytest.mark.realtime
class OneAgainstAll(Contract):
    output_kind = "one-against-all"
    keeps_order = False

    @pytest.fixture(autouse=True)
    def _no_boot(self, monkeypatch):
        monkeypatch.setattr("smarttouch.boards.kits.BOOT_S", 0.0)

    @pytest.fixture(autouse=True)
    def _keep_sent(self, monkeypatch):
        """Record all written bytes: the delivery log of a kit does not show the host's commands."""
        self.sent, write = [], Line.write

        def kept(line, data, proved=None):
            self.sent.append((time.monotonic_ns(), bytes(data)))
            write(line, data, proved)

        monkeypatch.setattr(Line, "write", kept)


class TestKajimoto61(OneAgainstAll):
    electrodes, cathodic = 61, False
    width_us, discharge_us = 50, 150
    step_ua = 39.0625

    def pulses(self):
        return decoded(self.sent, Kajimoto61Firmware(DeliveryLog(61)), extra_us=8)

    @pytest.fixture
    def url(self, start_emulator, tmp_path):
        options = {"protocol": "kajimoto61", "electrodes": 61}
        return "kajimoto61:" + start_emulator(f"books={tmp_path}", **options)[1]


class TestETactileKit(OneAgainstAll):
    step_ua, counts_passes = 9.99, False

    def pulses(self):
        return decoded(self.sent, ETactileKitFirmware(DeliveryLog(8), firmware=self.firmware))

    @pytest.fixture
    def url(self, start_emulator, tmp_path):
        arguments = (f"books={tmp_path}", f"firmware={self.firmware}", *self.more)
        port = start_emulator(*arguments, protocol="etactilekit")[1]
        return f"etactilekit:{port}?firmware={self.firmware}"

    firmware, more = "71adee2", ()

    def test_the_time_to_zero_includes_the_bytes_of_zero(self, make_board):
        with make_board() as board:
            # The watchdog begins to send zero within 100 ms: 10 bits per byte at 921,600 Bd.
            assert board.capabilities.kept_ms >= 100 + 10 * len(zero_anywhere(8)) / 921.6


@without_repeating
class TestNewestETactileKitOverTcp(TestETactileKit):
    more = ("tcp",)
    firmware = "newest"


class TestMemory(Contract):
    """``memory:`` has no firmware: its pulses are those of the sequences written to the driver."""

    @pytest.fixture
    def url(self):
        return "memory:"

    def pulses(self):
        """Return the pulses of all sequences that were written."""
        sent = [call.args[0] for call in self.calls.write.mock_calls]
        return [pulse for each in sent for pulse in planned_pulses(each.sequence, each.times)]

    def assert_silent(self):
        assert len(self.driver.sequences) <= 2

    def test_a_newer_sequence_ends_a_repetition(self, make_board):
        with make_board() as board:
            board.send(self.sequence(0), times=1000)
            board.send(self.sequence(1))
            assert len(board.driver.sequences) == 2


class TestSimulated(TestMemory):
    """``simulated:`` runs its firmware in this process, and reports the delivered pulses."""

    shows_recharges = False

    @pytest.fixture
    def url(self):
        return "simulated:"

    def pulses(self):
        _, width_us, current_ua = self.driver.take_pulses()
        return [
            SentPulse(tuple(map(float, row)), width)
            for row, width in zip(current_ua, width_us.tolist(), strict=True)
        ]

    def _start(self, board):
        # `send` simulates all repetitions before it returns, so a few are enough.
        board.send(self.sequence(0))
        board.send(self.sequence(1), times=20)

    def assert_silent(self):
        # A test delivers at most the 80 slots of `_start`, or all slots of a measurement if more.
        in_pairs = self.output.kind == "weighted"
        probes = probe_sequences(self.driver._limits, self.output, in_pairs=in_pairs)
        books = self.driver._firmware.books
        assert books.slots <= max(80, sum(each.slots for each in probes))
        assert books.state == "shorted"

    def test_a_newer_sequence_ends_a_repetition(self, make_board):
        # Simulated time passes within `send`: a repetition ends before a newer sequence comes.
        with make_board() as board:
            board.send(self.sequence(0))
            board.send(self.sequence(1), times=10)
            board.send(self.sequence(2, sites=[5]))
            assert board.report().slots == 41

    def test_what_the_firmware_refuses_ends_it(self, make_board, monkeypatch):
        with make_board() as board:
            board.send(self.sequence(0))
            refused = BrokenRule(Rule.TOTAL, value=1234)
            monkeypatch.setattr(LinkRules, "check", lambda *_: refused)
            with raises(BoardError, names="board", value=2) as error:
                board.send(self.sequence(1))
            assert "1234" in str(error.value)
            assert (board.refused, self.driver._firmware.books.violations) == (1, 1)
        self.assert_silent()


@pytest.mark.realtime
@without_repeating
class TestFirmware(Contract):
    @pytest.fixture
    def url(self, start_firmware, tmp_path):
        # The board has no ramp: see the fixture `claimed_time`.
        options = (f"--books={tmp_path}", "--ramp-ms=0")
        return "link:" + start_firmware(*options, output=self.output_kind)[1]


@pytest.mark.long
class TestCortexM3(TestFirmware):
    @pytest.fixture
    def url(self, start_cortex_m3, tmp_path):
        given = {"electrodes": self.electrodes, "output": self.output_kind, "ramp_ms": 0}
        return "link:" + start_cortex_m3(tmp_path, **given).name

    instants = 2

    def pulses(self):
        """Return the pulses without discharge times: QEMU makes discharges longer than planned."""
        return [replace(pulse, discharge_us=None) for pulse in super().pulses()]


@pytest.mark.realtime
def test_a_sudden_rise_is_refused(start_firmware, tmp_path, make_limits, make_sequence):
    """The board has its own ramp: it refuses an intensity that the gate of this test accepts."""
    port = start_firmware(f"--books={tmp_path}")[1]
    with make_board(f"link:{port}", make_limits(), Output(kind="weighted")) as board:
        deliver(board, make_sequence(0))
        board.send(make_sequence(1))
        until(lambda: board.refused == 1)
        with raises(BoardRestartedError, names="board"):
            board.send(make_sequence(2))
        state = fresh_state(tmp_path)
    assert (state["slots"], state["violations"]) == (0, 1)


@pytest.mark.realtime
def test_a_board_whose_session_is_over_gets_its_kernels_in_another(start_firmware, make_limits):
    """A pause of the program that is longer than the host timeout ends the session."""
    limits = make_limits()
    table = random_table(np.random.default_rng(0), 9, limits.electrodes)
    port = start_firmware()[1]
    with make_board(f"link:{port}", limits, Output(kind="weighted")) as board:
        driver = board.driver
        driver.idle = lambda: 0.01
        time.sleep(0.3)
        del driver.idle
        first = driver._session.number
        board.keep_kernels(table)
        assert driver._session.number != first
