"""Stops an emulated board at random instants while it measures, rises or repeats.

``python tests/stress/stop_drivers.py link measuring 500`` prints what was found as JSON.
In turn the stop comes from another thread of the host, and from another process, as a signal
whose handler stops the board in the very thread that drives it. The board stays open after that,
and its host tries to go on. What counts is the board's own account on its own clock.
"""

import argparse
import json
import os
import random
import select
import signal
import threading
import time
from collections import Counter
from functools import partial

from kill_host import ELECTRODES, LEAVES_WITHIN_S, PlayedBoard, fork_host, reap, repeat

from smarttouch.base.errors import (
    BoardRestartedError,
    LineLostError,
    SafetyError,
    SequenceLateError,
    SmartTouchError,
)
from smarttouch.boards.open import make_board
from smarttouch.boards.probe_scans import one_each
from smarttouch.stimulation.safety_gate import SafetyLimits

KITS = ("71adee2", "newest")
KINDS = ("link", "kajimoto61", *(f"etactilekit {firmware}" for firmware in KITS))
ACTIONS = ("measuring", "rising", "repeating")
RISE_S, MOST, STEP_S, REPEATED = 0.6, 0.25, 0.02, 3
"""Time from zero to full intensity, what it rises to, its steps, and the one that is repeated."""
LATEST_S = 0.6
WATCHED_NS = 250_000_000
"""Longer than two periods of sense scans."""
PATIENCE_S = 30.0


def send(board, limits, step, times=1, most=MOST):
    """Send the points of a step of the rise; return the next step."""
    intensity = min(most, step * STEP_S / RISE_S)
    sequence = one_each(
        limits, int(0.9 * intensity * 2800), 50, intensity, time.monotonic_ns(), cathodic=False,
        discharge_us=150, period_us=int(1e6 * STEP_S), sites=[1, 3, 5, 7],
    )  # fmt: skip
    board.send(sequence, times)
    time.sleep(STEP_S)
    return step + 1


def act(board, limits, action, stopped):
    """Drive a board until that is refused."""
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
        except (BoardRestartedError, SequenceLateError, SafetyError):
            # On a busy computer a host may stand still by itself, or nothing of what opens the
            # level is out yet: it begins again at zero.
            step = 0


def wait_for(stopped):
    # Not by an event, whose lock a signal's handler might find taken by its own thread.
    deadline = time.monotonic() + PATIENCE_S
    while not stopped and time.monotonic() < deadline:
        time.sleep(0.01)


def drive(url, electrodes, action, from_thread, at_s, said):
    """Drive a board until it is stopped, then try to go on; write down what came of it."""
    limits = SafetyLimits(electrodes, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.8)
    board, stopped = make_board(url, limits), []

    def stop(*_):
        try:
            board.stop()
        except LineLostError:
            # A host that stood still cannot confirm zero: its board is at zero by itself by then.
            time.sleep(0.1)
        os.write(said, b"stopped\n")
        stopped.append(True)

    board.open()
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


def one_run(kind, action, from_thread, at_s):
    kind, _, option = kind.partition(" ")
    board = PlayedBoard(kind, *option.split())
    url = board.url + (f"?firmware={option}" if option else "")
    (ours, said), electrodes = os.pipe(), ELECTRODES[kind]
    host = fork_host(board.line, partial(drive, url, electrodes, action, from_thread, at_s, said))
    books, told, go_s, stopped_ns = board.books, b"", None, None
    begun = time.monotonic()
    while (
        stopped_ns is None
        or told.count(b"\n") < 3
        or board.clock.now_ns() < stopped_ns + WATCHED_NS
    ):
        assert time.monotonic() < begun + PATIENCE_S, (kind, action, from_thread, at_s, told)
        # First what it says, then what it had written before.
        if select.select([ours], [], [], 0)[0]:
            told += os.read(ours, 1000)
        board.go_on()
        if go_s is None and b"open" in told:
            go_s = time.monotonic() + at_s
        if go_s and not from_thread and time.monotonic() > go_s:
            os.kill(host, signal.SIGTERM)
            go_s = float("inf")
        if stopped_ns is None and b"stopped" in told:
            board.catch_up()
            stopped_ns = board.clock.now_ns()
    os.kill(host, signal.SIGKILL)
    left = reap(time.monotonic() + LEAVES_WITHIN_S)
    for end in (ours, said, board.line._master):
        os.close(end)
    return {
        "pulsed": books.slots > 0, "late_ms": board.pulses_after_ms(stopped_ns),
        "wrong": books.unsafe + books.violations, "driving": books.state == "driving",
        "came": json.loads(told.splitlines()[-1]), "left": left,
    }  # fmt: skip


def run(kind, action, count, seed=0):
    """Return what so many runs found."""
    draw = random.Random(f"{seed} {kind} {action}")
    runs = repeat(
        lambda number: one_run(kind, action, bool(number % 2), draw.uniform(0, LATEST_S)), count
    )
    return {
        "board": kind, "action": action, "runs": count,
        "pulsed": sum(each["pulsed"] for each in runs),
        "worst_ms": round(max(each["late_ms"] for each in runs), 2),
        "wrong": sum(each["wrong"] for each in runs),
        "driving": sum(each["driving"] for each in runs),
        "came": Counter(name for each in runs for name in each["came"]),
        "processes_left": sum(each["left"] for each in runs),
    }  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("action", choices=ACTIONS)
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(json.dumps(run(options.kind, options.action, options.count, options.seed)))
