"""Kills or stops the host of an emulated board at random instants: when does the last pulse end?

``python tests/stress/kill_host.py etactilekit 100`` prints what was found as JSON. One process
plays the boards and forks a host for each run, so that a run costs no start of a program. What
counts is the board's own account on the board's own clock, which stands still while this process
is kept from running. Linux only: orphans are collected here, so that none stays behind unseen.
"""

import argparse
import ctypes
import json
import os
import random
import signal
import time
import traceback
from dataclasses import dataclass
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from smarttouch.base.errors import BoardRestartedError, SafetyError, SequenceLateError
from smarttouch.boards.kits import current_scale
from smarttouch.boards.open import make_board
from smarttouch.boards.probe_scans import one_each
from smarttouch.emulator.device_lines import PtyLine
from smarttouch.emulator.etactilekit_firmware import ETactileKitFirmware
from smarttouch.emulator.firmware import DeliveryLog, DeviceClock
from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware
from smarttouch.emulator.link_firmware import LinkFirmware
from smarttouch.stimulation.safety_gate import SafetyLimits

ELECTRODES = {"link": 64, "kajimoto61": 61, "etactilekit": 32}
KINDS = tuple(ELECTRODES)
RISE_S, MOST = 0.6, 0.25
"""Time from zero to full intensity, and what it rises to."""
LATEST_S = 0.5
"""The host is gone at any instant until then: after its start, or after its first pulse."""
OPENING = 4
"""One host in so many is gone by its start, which may be while it opens the board."""
PULSES_WITHIN_S = 30.0
WATCHED_NS = 600_000_000
LEAVES_WITHIN_S = 10.0
PR_SET_CHILD_SUBREAPER = 36


class LastPulse(DeliveryLog):
    """Books that know when the last pulse ended."""

    ended_us = -np.inf

    def enter(self, *entry, **more):
        width_us, time_us = entry[4], entry[6]
        self.ended_us = max(self.ended_us, time_us + width_us)
        super().enter(*entry, **more)


@dataclass
class Outcome:
    """One run: what the board did after the host was gone."""

    zero_ms: float
    """From the host's end to the end of the last pulse; 0 if none came after."""
    drove: bool
    """Whether there were pulses in the 50 ms before."""
    unsafe: int
    released: bool
    left: int
    """Processes that did not end."""


class PlayedBoard:
    """A board that this process plays, on a line of its own."""

    def __init__(self, kind, firmware="71adee2"):
        books = LastPulse(ELECTRODES[kind])
        self.firmware = {
            "link": lambda: LinkFirmware("weighted", books),
            "kajimoto61": lambda: Kajimoto61Firmware(books),
            "etactilekit": lambda: ETactileKitFirmware(books, firmware=firmware),
        }[kind]()
        self.books, self.line, self.clock, self._pending = books, PtyLine(), DeviceClock(), b""
        self.url = f"{kind}:{self.line.name}"

    def go_on(self):
        """Take what has come, and answer."""
        data = self.line.read(0.0005)
        now = self.clock.now_ns()
        self._pending += self.firmware.feed(data, now) if data else self.firmware.advance(now)
        if self._pending and data is not None:
            self._pending = self.line.write(self._pending)

    def catch_up(self):
        """Take what was written by now, however late this process comes to read it."""
        while data := self.line.read(0):
            self._pending += self.firmware.feed(data, self.clock.now_ns())

    def pulses_after_ms(self, since_ns):
        """Return for how long after a time there were pulses; 0 if none came."""
        return max(0.0, (self.books.ended_us - since_ns / 1e3) / 1e3)


def drive(url, electrodes):
    """Drive a board for ever, with a pattern that is never the same."""
    # The limits of this drive are its own: it is about what comes after it.
    limits = SafetyLimits(electrodes, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.8)
    draw = random.Random(os.getpid())
    with make_board(url, limits) as board:
        start_ns = time.monotonic_ns()
        now_ns = start_ns
        while True:
            intensity = min(MOST, (now_ns - start_ns) / 1e9 / RISE_S)
            level = max(0, int(intensity * 2800) - draw.randrange(20))
            sequence = one_each(
                limits, level, 50, intensity, now_ns, cathodic=False, discharge_us=150,
                period_us=20_000, sites=draw.sample(range(electrodes), 6),
            )  # fmt: skip
            # Repeated for a second, so that only what is shown here ends it.
            try:
                board.send(sequence, 50)
                time.sleep(0.02)
                now_ns = time.monotonic_ns()
            except (BoardRestartedError, SequenceLateError, SafetyError):
                # On a busy computer a host may stand still by itself, or nothing of what opens the
                # level is out yet: it begins anew.
                start_ns = now_ns = time.monotonic_ns()


def fork_host(line, work):
    if child := os.fork():
        return child
    try:
        # The far end is the board's alone.
        os.close(line._master)
        work()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(1)


def reap(deadline):
    """Return how many processes do not end in time."""
    while time.monotonic() < deadline:
        try:
            if os.waitpid(-1, os.WNOHANG)[0] == 0:
                time.sleep(0.002)
        except ChildProcessError:
            return 0
    return 1


def one_run(kind, how, option, opening, at_s):
    board = PlayedBoard(kind)
    line, books, gone_ns, drove = board.line, board.books, None, False
    host = fork_host(line, partial(drive, board.url + option, ELECTRODES[kind]))
    begun = time.monotonic()
    go_s = begun + at_s if opening else None
    while gone_ns is None or board.clock.now_ns() < gone_ns + WATCHED_NS:
        board.go_on()
        if go_s is None and books.ended_us > -np.inf:
            go_s = time.monotonic() + at_s
        assert go_s or time.monotonic() < begun + PULSES_WITHIN_S, "it never pulsed"
        if gone_ns is None and go_s and time.monotonic() > go_s:
            gone_ns = board.clock.now_ns()
            os.kill(host, signal.SIGKILL if how == "kill" else signal.SIGSTOP)
            board.catch_up()
            drove = books.ended_us > gone_ns / 1e3 - 50_000
    os.kill(host, signal.SIGKILL)
    left = reap(time.monotonic() + LEAVES_WITHIN_S)
    while line.read(0) == b"":
        pass
    released = line.read(0) is None
    os.close(line._master)
    return Outcome(board.pulses_after_ms(gone_ns), bool(drove), books.unsafe, released, left)


def repeat(one, count):
    """Return what so many runs found, each given its number."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    current_scale.BOOT_S = 0.0
    with threadpool_limits(1):
        return [one(number) for number in range(count)]


def run(kind, count, how="kill", option="", seed=0):
    """Return what so many runs found."""
    draw = random.Random(seed)
    outcomes = repeat(
        lambda number: one_run(kind, how, option, number % OPENING == 0, draw.uniform(0, LATEST_S)),
        count,
    )
    zero_ms = [each.zero_ms for each in outcomes if each.drove]
    return {
        "board": kind + option,
        "how": how,
        "runs": count,
        "driving": len(zero_ms),
        "median_ms": round(float(np.median(zero_ms)), 1) if zero_ms else None,
        "worst_ms": round(max(each.zero_ms for each in outcomes), 1),
        "unsafe": sum(each.unsafe for each in outcomes),
        "ports_kept": sum(not each.released for each in outcomes),
        "processes_left": sum(each.left for each in outcomes),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("count", type=int)
    parser.add_argument("--how", choices=("kill", "stop"), default="kill")
    parser.add_argument("--option", default="", help="after the port, for example ?firmware=newest")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    found = run(options.kind, options.count, options.how, options.option, options.seed)
    print(json.dumps(found))
