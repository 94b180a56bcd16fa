"""Calls of the package's own functions, and files they stand in, for a frame and for a start.

Run with::

    pytest tests/benchmarks/test_calls.py --benchmark-only -n0

A frame: all between one read of the source and the next, the level open, the median of frames. A
start: from the command line to the first sequence. What other threads call does not count.
"""

import collections
import json
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import smarttouch as st
from smarttouch.sources.source_contract import Frame, OpticalSource, Pose

PACKAGE = str(Path(st.__file__).parent)
FRAMES = 160
MOST = {
    "memory:, RA": (71, 22),
    "emulator:, RA": (118, 28),
    "emulator:, NATURAL": (125, 30),
    "start of live": (3400, 92),
}
"""Calls and files at most; a start also counts how often it looks whether the emulator is up."""
START = """
    import collections, inspect, json, sys
    from pathlib import Path
    calls = collections.Counter()
    package = str(Path(sys.argv[1]))
    def count(frame, event, _):
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(package):
            if code.co_flags & inspect.CO_OPTIMIZED and code.co_name[0] != "<":
                calls[code.co_filename, code.co_name] += 1
                if code.co_name == "send" and code.co_filename.endswith("boards/board.py"):
                    sys.setprofile(None)
    sys.setprofile(count)
    from smarttouch.cli import main
    sys.argv = "smarttouch live text:H --board emulator: --seconds .3 --quiet".split()
    try:
        main()
    finally:
        print(json.dumps([[*key, times] for key, times in calls.items()]))
"""


class Dots(OpticalSource):
    """Frames of dots that move, without end."""

    def __init__(self, profile):
        super().__init__("dots")
        optics = profile.optics
        random = np.random.default_rng(1)
        dots = random.random((8, optics.sensor_rows, optics.sensor_columns)) < 0.3
        self._images = [np.where(each, 20, 230).astype(np.uint8) for each in dots]
        self._number = 0
        self.counts = []

    def read(self, time_ns):
        self._number += 1
        self.counts.append(collections.Counter())
        image = self._images[self._number % len(self._images)]
        return Frame(image, time_ns, Pose(0, 0), 0.9, number=self._number)


def figures(counter):
    """Return the number of calls, and of files."""
    return sum(counter.values()), len({name for name, _ in counter})


def calls_of_a_frame(board, mode):
    """Return the calls of the median frame while its run is steady, by file and function."""
    profile = st.load_profile("electric-mouse")
    source = Dots(profile)

    def count(frame, event, _):
        code, caller = frame.f_code, frame.f_back
        # The loop asks for the time while it waits for the next period: that is no work.
        if (
            event == "call"
            and code.co_filename.startswith(PACKAGE)
            and code.co_name[0] != "<"
            and "wait_until" not in (caller.f_code.co_name, caller.f_back.f_code.co_name)
        ):
            source.counts[-1][code.co_filename, code.co_name] += 1

    source.counts.append(collections.Counter())
    with st.open_display(board, profile) as display:
        sys.setprofile(count)
        try:
            st.run(source, display, mode=mode, seconds=FRAMES / 50, force="fixed:0.9")
        finally:
            sys.setprofile(None)
    steady = sorted(source.counts[len(source.counts) // 2 : -3], key=figures)
    return steady[len(steady) // 2]


def calls_of_a_start():
    """Return the calls from the command line to the first sequence, by file and function."""
    command = [sys.executable, "-c", textwrap.dedent(START), PACKAGE]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    rows = json.loads(done.stdout.splitlines()[-1])
    return collections.Counter({(file, name): times for file, name, times in rows})


@pytest.mark.parametrize("what", MOST)
def test_calls(row, what):
    if what.startswith("start"):
        counter = calls_of_a_start()
    else:
        counter = calls_of_a_frame(*what.split(", "))
    calls, files = figures(counter)
    row("Calls of own functions", {"what": what, "calls": calls, "files": files})
    most_calls, most_files = MOST[what]
    assert calls <= most_calls
    assert files <= most_files
