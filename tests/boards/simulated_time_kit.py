"""An emulated eTactileKit and its driver in this process, with a simulated clock."""

import random
from dataclasses import dataclass, field

import numpy as np

from smarttouch.base.clock import LATE_NS
from smarttouch.boards import kits
from smarttouch.boards.board import Board
from smarttouch.boards.kits import etactilekit_protocol
from smarttouch.boards.kits.etactilekit import ETactileKitDriver
from smarttouch.emulator.etactilekit_firmware import ETactileKitFirmware
from smarttouch.emulator.firmware_base import DeliveryLog

from ..support.scans import unproved

US, MS = 1000, 1_000_000


class ManualClock:
    """Simulated clock. Only waits advance it, and each wait ends a little late."""

    def __init__(self, seed=1, late_us=200):
        self.time_ns = 0
        self.late_us = late_us
        self.random = random.Random(seed)

    def now_ns(self):
        return self.time_ns

    def wait_until(self, deadline_ns, stop):
        if deadline_ns > self.time_ns:
            late_ns = US * self.random.expovariate(1 / self.late_us) if self.late_us else 0
            self.time_ns = deadline_ns + int(late_ns)

    def sleep(self, seconds):
        self.time_ns += int(1e9 * seconds)


class ManualPort:
    """Simulated port of an emulated firmware. Bytes arrive after about (100 + ``wire_us``) µs.

    The board's clock shows (host time + ``phase_ns``) * (1 + ``drift``).
    """

    def __init__(self, firmware, clock, phase_ns=0, drift=0.0, wire_us=100.0):
        self.firmware, self.clock = firmware, clock
        self.phase_ns, self.drift, self.wire_us = phase_ns, drift, wire_us
        self.is_open, self.at_zero, self.timeout = True, False, 0.05
        self.coming, self.going, self.incoming = [], [], bytearray()
        self.said = bytearray()

    def arm(self):
        """Do nothing: no watchdog is needed, because host and board end together."""

    def board_ns(self, time_ns):
        return int((time_ns + self.phase_ns) * (1 + self.drift))

    def _wire_ns(self):
        return int(US * (100 + self.clock.random.expovariate(1 / self.wire_us)))

    def write(self, data):
        arrival = self.clock.time_ns + self._wire_ns()
        if self.going:
            arrival = max(arrival, self.going[-1][0])
        self.going.append((arrival, bytes(data)))
        self.said += data
        self.clock.time_ns += 20 * US
        return len(data)

    def _let_pass(self):
        now = self.clock.time_ns
        while self.going and self.going[0][0] <= now:
            arrival, data = self.going.pop(0)
            self._say(self.firmware.feed(data, self.board_ns(arrival)), arrival)
        self._say(self.firmware.advance(self.board_ns(now)), now)
        while self.coming and self.coming[0][0] <= now:
            self.incoming += self.coming.pop(0)[1]

    def _say(self, answer, time_ns):
        if answer:
            self.coming.append((time_ns + self._wire_ns(), answer))

    def read(self, count=1):
        end = self.clock.time_ns + int(1e9 * self.timeout)
        while True:
            self._let_pass()
            if len(self.incoming) >= count or self.clock.time_ns >= end:
                taken = bytes(self.incoming[:count])
                del self.incoming[:count]
                return taken
            self.clock.time_ns += 100 * US

    def reset_input_buffer(self):
        self._let_pass()
        self.incoming.clear()

    def close(self):
        self.is_open = False


@dataclass
class ScanBooks(DeliveryLog):
    """Delivery log that also stores the height of each pulse, in counts, by scan and electrode."""

    scans: dict = field(default_factory=dict)

    def enter(self, number, slot, site, delivered, width_us, residual_uc, time_us, *, more=False):
        super().enter(number, slot, site, delivered, width_us, residual_uc, time_us, more=more)
        self.scans.setdefault(number, {})[site] = round(abs(delivered.current_ua[site]) / 9.99)


def proved(sequence, times=1, number=0, due_ns=0, late_ns=LATE_NS):
    """Return a sequence as if the gate had proved it, so that a test needs only the driver."""
    return unproved(sequence, times, number, due_ns, due_ns + late_ns)


class ManualKit:
    """Driver and emulated board in one thread; with ``opened=False`` the test opens the board."""

    def __init__(
        self, patch, limits, firmware="71adee2", seed=1, late_us=200, finger=None,
        dummy_ohm=np.inf, named=True, board=None, opened=True, **line,
    ):  # fmt: skip
        self.clock = ManualClock(seed, late_us)
        self.books = ScanBooks(limits.electrodes)
        self.board = board or ETactileKitFirmware(
            self.books, finger, firmware=firmware, dummy_ohm=dummy_ohm
        )
        self.port = ManualPort(self.board, self.clock, **line)
        self.driver = ETactileKitDriver("told", limits, firmware=firmware if named else None)
        patch.setattr(kits, "BOOT_S", 0.0)
        patch.setattr(etactilekit_protocol, "WatchedPort", lambda port, _: port)
        self.line = Board(self.driver, limits, clock=self.clock)._line
        self.host = self.line.board

        def connect(name, wrap):
            self.line.name, self.line._port = name, wrap(self.port)

        self.line.connect, self.line.pause = connect, self.clock.sleep
        if opened:
            self.host.capabilities = self.driver.open(self.line, limits)

    def run(self, jobs):
        """Write all jobs (host time in ns, sequence, repetitions), then zero; return the report."""
        for number, (time_ns, sequence, times) in enumerate(jobs, 1):
            self.clock.time_ns = max(self.clock.time_ns, time_ns)
            # `write` returns once the driver accepts another sequence, so the next one is due now.
            self.driver.write(proved(sequence, times, number, self.clock.time_ns))
        self.driver.zero()
        return self.host.report()

    def assert_located(self):
        """Assert that the last scan began within the time span that the driver estimated."""
        lock, port = self.driver._lock, self.port
        began_ns = self.board._started_ns / (1 + port.drift) - port.phase_ns
        scan = lock.scan(lock._near(began_ns))
        assert scan.early - 1000 <= began_ns <= scan.late + 1000

    def scans(self):
        """Return a set of (electrode, height of its pulse in counts) for each scan with pulses."""
        return [frozenset(each.items()) for _, each in sorted(self.books.scans.items())]
