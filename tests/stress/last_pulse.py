"""Measurement of the last pulse of an emulated board whose host ends at a random time.

``python tests/stress/last_pulse.py etactilekit kill 100`` prints the results of 100 runs as JSON.
With ``kill`` or ``freeze``, the host is killed or frozen while it opens or drives its board. With
the other actions, a second thread or a signal handler stops the board, and the host tries to
continue.
This process emulates the boards, and forks the hosts, which is faster than starting programs. Times
are those of the board's clock, which stands still while this process is delayed. Linux only: this
process adopts and counts the processes that a host leaves behind.
"""

import argparse
import ctypes
import json
import os
import random
import select
import signal
import threading
import time
import traceback
from collections import Counter
from contextlib import closing, suppress
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from smarttouch.base.errors import (
    BoardRestartedError,
    LineLostError,
    SafetyError,
    SequenceLateError,
    SmartTouchError,
)
from smarttouch.boards import kits
from smarttouch.boards.open import make_board
from smarttouch.emulator.device_lines import PtyLine
from smarttouch.emulator.etactilekit_firmware import ETactileKitFirmware
from smarttouch.emulator.firmware_base import DeliveryLog, DeviceClock
from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware
from smarttouch.emulator.link_board import LinkFirmware
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

ELECTRODES = {"link": 64, "kajimoto61": 61, "etactilekit": 32}
SIGNALS = {"kill": signal.SIGKILL, "freeze": signal.SIGSTOP}
ACTIONS = ("measuring", "rising", "repeating")
RISE_S, MOST = 0.6, 0.25
"""Duration of a ramp from 0 to 1, and the largest intensity that is sent."""
STEP_S, REPEATED = 0.02, 3
LATEST_S = 0.6
"""Largest random delay before a host is killed or frozen, or its board is stopped."""
OPENING = 4
"""Every fourth host is killed or frozen after its start, the others after their first pulse."""
PATIENCE_S, LEAVES_WITHIN_S = 30.0, 10.0
WATCHED_NS = 600_000_000
AWAKE_NS = 250_000_000
"""Time for which a board is observed after a stop: more than two periods of a sense scan."""
PR_SET_CHILD_SUBREAPER = 36
NOT_YET = BoardRestartedError, SequenceLateError, SafetyError
"""Errors after which a host restarts at zero: on a busy computer the host can be late, or the
sequences that raise the ramp have not been written yet."""


class LastPulse(DeliveryLog):
    """Delivery log that also stores the end of the last pulse."""

    ended_us = -np.inf

    def enter(self, *entry, **more):
        width_us, time_us = entry[4], entry[6]
        self.ended_us = max(self.ended_us, time_us + width_us)
        super().enter(*entry, **more)


class BoardWithHost:
    """Board that this process emulates on a pseudo-terminal, and the forked host that drives it."""

    def __init__(self, kind):
        kind, _, firmware = kind.partition(" ")
        self.electrodes = ELECTRODES[kind]
        books = LastPulse(self.electrodes)
        self.firmware = {
            "link": lambda: LinkFirmware("weighted", books),
            "kajimoto61": lambda: Kajimoto61Firmware(books),
            "etactilekit": lambda: ETactileKitFirmware(books, firmware=firmware or "71adee2"),
        }[kind]()
        self.books, self.line, self.clock, self._pending = books, PtyLine(), DeviceClock(), b""
        self.url = f"{kind}:{self.line.name}" + f"?firmware={firmware}" * bool(firmware)

    def fork_host(self, drive):
        """Fork a host that calls ``drive`` with a board on this line and its limits."""
        if child := os.fork():
            self._host = child
            return
        try:
            # Only the parent process may hold the board's end of the line.
            os.close(self.line._master)
            limits = SafetyLimits(self.electrodes, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.8)
            drive(make_board(self.url, limits), limits)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(1)

    def serve(self):
        """Process the received bytes, and answer."""
        data = self.line.read(0.0005)
        now = self.clock.now_ns()
        self._pending += self.firmware.feed(data, now) if data else self.firmware.advance(now)
        if self._pending and data is not None:
            self._pending = self.line.write(self._pending)

    def signal(self, number):
        os.kill(self._host, number)

    def catch_up(self):
        """Process everything that the host has written so far, also if this process is late."""
        while data := self.line.read(0):
            self._pending += self.firmware.feed(data, self.clock.now_ns())

    def end(self, since_ns):
        """Kill the host; return what the board has delivered since ``since_ns`` (board's clock)."""
        self.signal(signal.SIGKILL)
        left, deadline = 1, time.monotonic() + LEAVES_WITHIN_S
        while left and time.monotonic() < deadline:
            try:
                if os.waitpid(-1, os.WNOHANG)[0] == 0:
                    time.sleep(0.002)
            except ChildProcessError:
                left = 0
        while data := self.line.read(0.01):
            pass
        os.close(self.line._master)
        books = self.books
        return {
            # time from ``since_ns`` to the end of the last pulse; 0 if no pulse ended later
            "late_ms": max(0.0, (books.ended_us - since_ns / 1e3) / 1e3),
            "unsafe": books.unsafe, "violations": books.violations, "processes_left": left,
            "driving": books.state == "driving", "ports_kept": data is not None,
        }  # fmt: skip


def anodic(limits, level_ua, intensity, time_ns, sites):
    """Return a scan with an anodic slot for each site; all other electrodes are cathodes."""
    currents = np.full((len(sites), limits.electrodes), level_ua // (limits.electrodes - 1))
    currents[np.arange(len(sites)), sites] = 0
    currents[np.arange(len(sites)), sites] = -currents.sum(axis=1)
    times_us = np.ones(len(sites), np.uint16)
    return ScanSequence(
        currents.astype(np.int16), 50 * times_us, 150 * times_us, np.array(sites, np.uint16),
        int(1e6 * STEP_S), intensity if len(sites) else 0.0, time_ns,
    )  # fmt: skip


def open_board(board):
    """Open a board; try again if the watchdog was late on a busy computer."""
    for _ in range(5):
        with suppress(LineLostError):
            return board.open()
    return board.open()


def drive_for_ever(board, limits):
    """Drive a board with random patterns until the process is killed."""
    draw = random.Random(os.getpid())
    open_board(board)
    with closing(board):
        start_ns = now_ns = time.monotonic_ns()
        while True:
            intensity = min(MOST, (now_ns - start_ns) / 1e9 / RISE_S)
            level = max(0, int(intensity * 2800) - draw.randrange(20))
            sites = draw.sample(range(limits.electrodes), 6) if level else []
            sequence = anodic(limits, level, intensity, now_ns, sites)
            # Without another sequence, the board would repeat this one for a second.
            try:
                board.send(sequence, 50)
                time.sleep(STEP_S)
                now_ns = time.monotonic_ns()
            except NOT_YET:
                start_ns = now_ns = time.monotonic_ns()


def gone_run(kind, how, opening, at_s):
    """Kill or freeze a host ``at_s`` after its start (if ``opening``) or after its first pulse."""
    board, gone_ns, pulsed = BoardWithHost(kind), None, False
    board.fork_host(drive_for_ever)
    begun = time.monotonic()
    go_s = begun + at_s if opening else None
    while gone_ns is None or board.clock.now_ns() < gone_ns + WATCHED_NS:
        board.serve()
        if go_s is None and board.books.ended_us > -np.inf:
            go_s = time.monotonic() + at_s
        assert go_s or time.monotonic() < begun + PATIENCE_S, "the board has not pulsed in time"
        if gone_ns is None and go_s and time.monotonic() > go_s:
            gone_ns = board.clock.now_ns()
            board.signal(SIGNALS[how])
            board.catch_up()
            # whether a pulse ended in the 50 ms before the end of the host
            pulsed = board.books.ended_us > gone_ns / 1e3 - 50_000
    return board.end(gone_ns) | {"pulsed": bool(pulsed)}


def send(board, limits, step, times=1):
    """Send a sequence with the intensity of a step; return the number of the next step."""
    intensity = min(MOST, step * STEP_S / RISE_S)
    sites = [1, 3, 5, 7] if step else []
    sequence = anodic(limits, int(0.9 * intensity * 2800), intensity, time.monotonic_ns(), sites)
    board.send(sequence, times)
    time.sleep(STEP_S)
    return step + 1


def act(board, limits, action, stopped):
    """Drive a board until it raises an error other than those in `NOT_YET`."""
    step = 0
    while True:
        try:
            if action == "measuring":
                board.measure()
            elif action == "rising" or step < REPEATED:
                step = send(board, limits, step)
            else:
                send(board, limits, REPEATED, 1000)
                wait_for(stopped)
        except NOT_YET:
            step = 0


def wait_for(stopped):
    # A threading.Event could deadlock: the signal handler may interrupt a thread that has its lock.
    deadline = time.monotonic() + PATIENCE_S
    while not stopped and time.monotonic() < deadline:
        time.sleep(0.01)


def drive_until_stopped(board, limits, action, from_thread, at_s, said):
    """Drive a board until it is stopped, try to continue, and write the raised errors to a pipe."""
    stopped = []

    def stop(*_):
        try:
            board.stop()
        except LineLostError:
            # A delayed host cannot confirm zero. After this pause the board is at zero anyway.
            time.sleep(0.1)
        os.write(said, b"stopped\n")
        stopped.append(True)

    open_board(board)
    signal.signal(signal.SIGTERM, stop)
    os.write(said, b"open\n")
    if from_thread:
        threading.Timer(at_s, stop).start()
    came = []
    for way in (
        partial(act, board, limits, action, stopped),
        board.measure,
        partial(send, board, limits, 0),
    ):
        try:
            way()
        except SmartTouchError as error:
            came.append(type(error).__name__)
        wait_for(stopped)
    os.write(said, json.dumps(came).encode() + b"\n")
    time.sleep(PATIENCE_S)


def stopped_run(kind, action, from_thread, at_s):
    """Stop a board while its host drives it."""
    board, (ours, said) = BoardWithHost(kind), os.pipe()
    board.fork_host(
        partial(
            drive_until_stopped, action=action, from_thread=from_thread, at_s=at_s, said=said
        )
    )  # fmt: skip
    told, go_s, stopped_ns, begun = b"", None, None, time.monotonic()
    while (
        stopped_ns is None or told.count(b"\n") < 3 or board.clock.now_ns() < stopped_ns + AWAKE_NS
    ):
        assert time.monotonic() < begun + PATIENCE_S, (kind, action, from_thread, at_s, told)
        # Read the pipe before the line: `serve` then processes all bytes that precede a message.
        if select.select([ours], [], [], 0)[0]:
            told += os.read(ours, 1000)
        board.serve()
        if go_s is None and b"open" in told:
            go_s = time.monotonic() + at_s
        if go_s and not from_thread and time.monotonic() > go_s:
            board.signal(signal.SIGTERM)
            go_s = float("inf")
        if stopped_ns is None and b"stopped" in told:
            board.catch_up()
            stopped_ns = board.clock.now_ns()
    for end in (ours, said):
        os.close(end)
    pulsed, came = board.books.slots > 0, json.loads(told.splitlines()[-1])
    return board.end(stopped_ns) | {"pulsed": pulsed, "came": came}


def run(kind, how, count):
    """Execute ``count`` runs; return a summary of their results."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    kits.BOOT_S = 0.0
    draw = random.Random(f"{kind} {how}")
    found = []
    with threadpool_limits(1):
        for number in range(count):
            at_s = draw.uniform(0, LATEST_S)
            if how in SIGNALS:
                found.append(gone_run(kind, how, number % OPENING == 0, at_s))
            else:
                found.append(stopped_run(kind, how, bool(number % 2), at_s))
    driven_ms = [each["late_ms"] for each in found if each["pulsed"]]
    counted = ("pulsed", "unsafe", "violations", "driving", "ports_kept", "processes_left")
    return {
        "board": kind, "how": how, "runs": count,
        "median_ms": round(float(np.median(driven_ms)), 1) if driven_ms else None,
        "worst_ms": round(max(each["late_ms"] for each in found), 2),
        **{name: sum(each[name] for each in found) for name in counted},
        "came": Counter(name for each in found for name in each.get("came", ())),
    }  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", help=f"board: {', '.join(ELECTRODES)} or 'etactilekit newest'")
    parser.add_argument("how", choices=(*SIGNALS, *ACTIONS))
    parser.add_argument("count", type=int)
    options = parser.parse_args()
    print(json.dumps(run(options.kind, options.how, options.count)))
