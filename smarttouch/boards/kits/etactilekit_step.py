"""Synchronization with the scans of an eTactileKit, which runs on its own clock.

A scan is fixed when it starts, so a pattern is scanned only if it is there at that moment. Pulses
are enabled, as many scans as wanted start, and pulses are stopped again; in between the next
pattern is loaded. The board does not report its scans, but its readings change with each of them,
so two queries bracket one, and from then on all others are known (`ScanLock`). Until then (before
the first measured pulse, or on a slow line), a pattern stays for longer than a whole period: it is
scanned once or twice, and the report has that range.
"""

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.driver import Driver
from smarttouch.boards.kits.current_scale import one_against_all
from smarttouch.boards.kits.etactilekit_line import ETactileKitLine
from smarttouch.boards.kits.etactilekit_wire import QUIET, SHORTEST_US, Settings
from smarttouch.boards.kits.scan_lock import WIDEST, ScanLock, Span
from smarttouch.stimulation.safety_gate import ProvedSequence
from smarttouch.stimulation.scan_sequence import ScanSequence

LOW, HIGH = 4, 12  # readings below 4 had no pulse, from 12 on they had one: .3 and 1 V
POLL_NS, MARGIN_NS = 1_000_000, 100_000
LATE_SCANS = 3  # additional scans to wait for if no time is certainly between two scans
WIDE_NS = 1_000_000  # above this uncertainty of a start, a query is sent in mid-scan
LISTEN_NS = 1_000_000_000  # at most one scan in this time is left empty to find starts
KEEP_NS = 100_000_000  # longest silence to the newest firmware


@dataclass
class ShownPattern:
    """Pattern that is being pulsed, and its start."""

    proved: ProvedSequence
    since: Span
    before: NDArray[np.uint16]  # readings of the previous scan
    unseen_ns: int = 0  # time of the last readings that showed none of its pulses
    risen: bool = False  # whether readings have shown some of its pulses

    def pulsed(self, readings: NDArray[np.uint16]) -> NDArray[np.bool_]:
        """Return which outputs it has certainly pulsed, by the present readings, (N,) bool."""
        return (self.before < LOW) & (readings >= HIGH)


class SteppedKit(Driver):
    """Driver of a kit that scans patterns a known number of times."""

    _kit: ETactileKitLine
    _wiring: NDArray[np.intp]
    _outputs: int

    def _begin(self, waits: bool) -> None:
        """Start without knowledge of the board's scans; ``waits`` if its parser stands still while
        it scans."""
        self._waits = waits
        self._settings: Settings | None = None  # what it pulses with; None if not certain
        self._lock = ScanLock(1)
        self._shown: ShownPattern | None = None
        # The time of the last query, and its readings.
        self._before: tuple[int, NDArray[np.uint16]] | None = None
        self._answer_ns = 0  # how long recent answers took
        self._listen_ns = 0  # when to run the next scan without pulses
        self._stopped_ns = 0
        self._seen_ua = 10**6  # the weakest pattern that was measured

    @abstractmethod
    def _note_volts(
        self,
        proved: ProvedSequence,
        current_ua: NDArray[np.int64],
        readings: NDArray[np.uint16],
    ) -> None:
        """Take the measured voltages of a sequence's slots, in counts."""

    def _ask(self, body: bytes, *, drives: ProvedSequence | None = None) -> Span | None:
        """Send commands and update the scan lock by the readings; return the time of execution."""
        found = self._kit.exchange(body, ask=True, drives=drives)
        if found is None:
            self._before = None
            self._kit.resync()
            return None
        span, readings = found
        assert readings is not None
        # An answer during a scan takes as long as the scan.
        took_ns = span.late - span.early
        self._answer_ns = min(took_ns, self._answer_ns * 9 // 8 or took_ns)
        if self._before is not None and self._settings is not None:
            self._learn(self._settings, self._before, span.late, readings)
        self._before = span.early, readings
        return span

    def _learn(
        self,
        settings: Settings,
        last: tuple[int, NDArray[np.uint16]],
        answered_ns: int,
        readings: NDArray[np.uint16],
    ) -> None:
        """Update the scan lock if a scan passed between two readings."""
        asked_ns, before = last
        rises, falls = (before < LOW) & (readings >= HIGH), (before >= HIGH) & (readings < LOW)
        if not (rises | falls).any():
            return
        # A pulse whose discharge is short, or one without a width, as in scans without pulses.
        rest_us = max(0, settings.discharge_us - SHORTEST_US)
        if self._waits:
            # A query during a scan is answered after it: the whole scan has passed.
            slot_us = rest_us + (settings.width_us if rises.any() else SHORTEST_US)
            self._lock.learn(Span(asked_ns, answered_ns - 1000 * self._outputs * slot_us))
            return
        # That slot passed between the two questions; its scan began so much earlier.
        slots = int((rises | falls).argmax())
        early_ns = asked_ns - 1000 * slots * settings.scan_us(1, 25)
        self._lock.learn(Span(early_ns, answered_ns - 1000 * slots * rest_us))

    def _free_of_scans(self, now_ns: int) -> int:
        """Return when an answer will come before the next scan can start, ns."""
        self._lock.check(now_ns)
        if not self._lock.locked:
            # In the newest firmware a scan that began before the stop may still run.
            return max(now_ns, self._stopped_ns + self._scan_ns())
        between_ns = self._lock.nominal_ns - self._scan_ns()
        answer_ns = min(3 * self._answer_ns, between_ns // 3)
        number = self._lock.first_after(now_ns) - 1
        if self._lock.scan(number).late > now_ns:
            return self._lock.scan(number).late + MARGIN_NS
        following = self._lock.scan(number + 1)
        return now_ns if now_ns + answer_ns < following.early else following.late + MARGIN_NS

    def _hold(self, proved: ProvedSequence) -> None:
        """Wait until the requested number of scans of the shown pattern is over."""
        shown, asked_ns, late = self._shown, self._kit.line.now_ns(), 0
        while shown is self._shown:
            now_ns = self._kit.line.now_ns()
            assert shown is not None
            due_ns = self._over_ns(shown.since, 1 if self._kit.line.has_newer() else proved.times)
            if now_ns >= due_ns:
                due_ns = self._free_of_scans(now_ns)
                if now_ns >= due_ns or late >= LATE_SCANS:
                    return
                late += 1
            ask_ns = self._worth_asking(now_ns, asked_ns)
            # A newer sequence may come meanwhile.
            until_ns = min(due_ns, ask_ns, now_ns + self._lock.nominal_ns)
            self._wait(until_ns)
            if until_ns == ask_ns:
                with self._kit.lock:
                    if shown is self._shown:
                        asked_ns = self._kit.line.now_ns()
                        answer = self._ask(b"") and self._before
                        if answer:
                            self._look(shown, asked_ns, answer[1])

    def _look(self, shown: ShownPattern, asked_ns: int, readings: NDArray[np.uint16]) -> None:
        """Keep the readings of the first scan of the shown pattern."""
        if not shown.pulsed(readings).any():
            shown.unseen_ns = asked_ns
            return
        scan = self._lock.last
        if not shown.risen and scan is not None and scan.late >= shown.since.early:
            # It was in that scan that its readings rose.
            shown.since = Span(scan.early - 1, scan.early - 1)
        shown.risen = True

    def _worth_asking(self, now_ns: int, asked_ns: int) -> int:
        """Return when the next query is useful: to locate scans, or to keep the board awake."""
        if not self._lock.locked:
            return now_ns + POLL_NS
        coming = self._lock.scan(self._lock.first_after(now_ns))
        if coming.late - coming.early > WIDE_NS:
            return min(asked_ns + KEEP_NS, (coming.early + coming.late) // 2)
        return asked_ns + KEEP_NS

    def _over_ns(self, since: Span, times: int) -> int:
        """Return when so many scans after an event are certainly over."""
        if not self._lock.locked:
            return int(since.late + times * self._lock.period_ns[1]) + MARGIN_NS
        last = self._lock.scan(self._lock.first_after(since.late) + times - 1)
        return last.late + self._scan_ns() + MARGIN_NS

    def _scan_ns(self) -> int:
        """Return the duration of a scan."""
        assert self._settings is not None
        return 1000 * self._settings.scan_us(self._outputs)

    def _listen(self) -> None:
        """Run a scan without pulses if its readings will show when it starts."""
        now_ns, before = self._kit.line.now_ns(), self._before
        self._lock.check(now_ns)
        if before is None or now_ns < self._listen_ns or not (before[1] >= HIGH).any():
            return
        end_ns = now_ns + int(self._lock.period_ns[1])
        if self._lock.locked:
            coming = self._lock.scan(self._lock.first_after(now_ns))
            if coming.late - coming.early <= min(2 * WIDE_NS, WIDEST * self._lock.nominal_ns / 2):
                return
            self._wait(coming.early - POLL_NS)
            end_ns = coming.late
        assert self._settings is not None
        end_ns += 1000 * self._settings.scan_us(self._outputs, 25) + POLL_NS
        while self._before is not None and (self._before[1] >= HIGH).any():
            if self._kit.line.now_ns() > end_ns:
                break
            self._wait(self._kit.line.now_ns() + POLL_NS // 2)
            self._ask(b"")
        self._listen_ns = self._kit.line.now_ns() + LISTEN_NS

    def _stop_pulses(self) -> bool:
        """Stop all pulses, and record the scans; return False if there seem to be none."""
        shown, self._shown = self._shown, None
        begun_ns, stopped = self._kit.line.now_ns(), None
        try:
            stopped = self._ask(QUIET)
        finally:
            self._stopped_ns = self._kit.line.now_ns()
            seen = self._account(shown, stopped, begun_ns) if shown is not None else True
        return seen

    def _account(self, shown: ShownPattern, stopped: Span | None, begun_ns: int) -> bool:
        """Record the scans of the shown pattern; return False if there seem to be none."""
        sequence, since, seen = shown.proved.sequence, shown.since, True
        readings = None if stopped is None or self._before is None else self._before[1]
        certain = False if readings is None else shown.pulsed(readings)
        if np.any(certain) and not shown.risen and self._settings is not None:
            # No scan had passed that slot when the readings last showed no pulse.
            slots = int(np.argmax(certain))
            unseen_ns = shown.unseen_ns - 1000 * slots * self._settings.scan_us(1, 25)
            since = Span(max(since.early, unseen_ns), max(since.late, unseen_ns))
        least, most = self._lock.starts(since, stopped or Span(begun_ns, self._kit.line.now_ns()))
        foreign = certain & self._unused(sequence)
        if readings is not None:
            electrode, current_ua = one_against_all(sequence)
            readings, level_ua = readings[self._wiring[electrode]], int(np.abs(current_ua).max())
            if np.any(certain):
                least, self._seen_ua = max(1, least), min(level_ua, self._seen_ua)
            elif level_ua >= self._seen_ua and (readings < LOW).all():
                # Weaker pulses were measured before: the board's timing has changed.
                self._lock.forget()
                least, seen = 0, False
            if least and self._lock.locked:
                self._note_volts(shown.proved, current_ua, readings)
        self._kit.line.events.delivered(shown.proved, least, most=max(least, most))
        if foreign.any():
            raise self._kit.line.events.fault(
                f"output {foreign.argmax()} pulsed, and its pattern has no pulse there"
            )
        return seen

    def _unused(self, sequence: ScanSequence) -> NDArray[np.bool_]:
        """Return which outputs a sequence does not pulse."""
        unused = np.ones(self._outputs, bool)
        unused[self._wiring[sequence.site]] = False
        return unused

    def _give_up(self) -> None:
        """Record the scans that may have run before a lost board came back at zero."""
        shown, self._shown = self._shown, None
        if shown is not None:
            sure_ns = shown.since.late if self._before is None else self._before[0]
            self._account(shown, None, max(sure_ns, shown.since.late))

    def _wait(self, until_ns: int) -> None:
        if until_ns > self._kit.line.now_ns():
            self._kit.line.wait_until(until_ns)
