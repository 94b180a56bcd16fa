"""Programs like those that users of the package write, for tests that stop them.

``programs_to_stop.py KIND URL`` drives a board for a minute. After a stop it tries to drive boards
again. It prints how each attempt ended.
"""

import contextlib
import os
import signal
import sys
import threading
import time

import numpy as np

import smarttouch as st
from smarttouch.base.errors import BoardRestartedError, LevelNotReachedError, SmartTouchError
from smarttouch.base.posix import prioritized
from smarttouch.sources.force import FixedForce

KIND, URL = sys.argv[1:3]
TEXT = "text:" + "Hello " * 40
FORCE = None if URL == "emulator:" else FixedForce("0.5")


def attempt(name, work):
    """Call a function. Print the type of its error, or "done" if it raises none."""
    try:
        work()
    except SmartTouchError as error:
        print(name, type(error).__name__, flush=True)
    else:
        print(name, "done", flush=True)


def run():
    recorder = st.Recorder(f"{os.getpid()}.mcap")
    source = st.open_source(TEXT, display.profile)
    done = st.run(source, display, intensity=1.0, seconds=60, listeners=[recorder], force=FORCE)
    print("ended by", done.ended, flush=True)


def session():
    recorder = st.Recorder(f"{os.getpid()}.mcap")
    with display.session(intensity=1.0, listeners=[recorder], force=FORCE) as touch:
        while True:
            # On a busy computer the ramp may restart too often to reach the level.
            with contextlib.suppress(LevelNotReachedError):
                touch.show(np.eye(64)[0], 60)
                return


@prioritized()
def drive(board, seconds=60.0):
    """Send sequences to an open board directly, without a run, at real-time priority."""
    ends_s = time.monotonic() + seconds
    while time.monotonic() < ends_s:
        source = st.open_source(TEXT, display.profile)
        # On a busy computer the board may be lost, or a sequence may be late: begin again at zero.
        with contextlib.suppress(BoardRestartedError):
            for step in st.steps(source, display.profile, intensity=0.05, scan="points"):
                board.send(step.sequence)
                time.sleep(step.sequence.period_us / 1e6)
                if time.monotonic() > ends_s:
                    break


def drive_opened():
    with display.board as board:
        drive(board)


def drive_anew():
    with st.open_display(URL).board as board:
        drive(board, 0.1)


display = st.open_display(URL)
if KIND == "own handler":
    signal.signal(signal.SIGTERM, lambda *_: print("own handler", flush=True))
if KIND == "thread":
    thread = threading.Thread(target=attempt, args=("run", run), daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.1)
elif KIND in ("run", "own handler"):
    attempt("run", run)
elif KIND == "session":
    attempt("session", session)
elif KIND == "left open":
    attempt("open", display.board.open)
    attempt("drive", lambda: drive(display.board))
    attempt("send", lambda: drive(display.board, 0.1))
else:
    attempt("drive", drive_opened)
attempt("again", drive_opened)
attempt("another", drive_anew)
attempt(
    "another run",
    lambda: st.run(
        st.open_source("text:a", display.profile), st.open_display(URL), intensity=1.0, force=FORCE
    ),
)
