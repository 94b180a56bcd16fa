"""A program that is killed, or has its disk filled, loses a tenth of a second at most."""

import os
import random
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from mcap.reader import make_reader

from smarttouch.recording.check import check_recording
from smarttouch.recording.reader import Recording
from smarttouch.recording.repair import repair

CHILD = Path(__file__).with_name("child.py")
KILLS = int(os.environ.get("SMARTTOUCH_KILLS", "3"))
MOST_LOST_MS = 100


@contextmanager
def child(*arguments):
    """Yield a running child; it is gone at the end."""
    process = subprocess.Popen(
        [sys.executable, CHILD, *map(str, arguments)], stdout=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("seed", range(KILLS))
def test_a_killed_program_loses_little(tmp_path, seed):
    path = tmp_path / "run.mcap"
    with child(path) as process:
        first = process.stdout.readline()
        time.sleep(random.Random(seed).uniform(0.2, 0.7))
        process.kill()
        told = [[int(each) for each in line.split()] for line in [first, *process.stdout]]
    last_ns = told[-1][0]
    # Where the machine did not let it run, its writer did not run either.
    held_up_ms = max(late_ns for _, late_ns in told[-15:]) / 1e6
    kept = list(Recording(path).steps())
    lost_ms = (last_ns - kept[-1].step.frame.time_ns) / 1e6
    print(f"killed at {last_ns / 1e6:.0f} ms: {lost_ms:.1f} ms lost, held up {held_up_ms:.1f} ms")
    assert [each.index for each in kept] == list(range(len(kept)))
    assert len(kept) > 5
    assert lost_ms <= MOST_LOST_MS + held_up_ms
    assert not Recording(path).whole
    check = check_recording(path)
    assert check.exact, check.describe()

    mended = repair(path)
    assert mended.path.name == "run-repaired.mcap"
    assert (mended.steps, mended.damaged_chunks) == (len(kept), 0)
    with mended.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages = sum(1 for _ in reader.iter_messages())
        assert messages == mended.messages == reader.get_summary().statistics.message_count
    assert Recording(mended.path).whole
    assert check_recording(mended.path).describe() == check.describe().removesuffix(
        " (the recording is cut)"
    )


def test_a_disk_that_fills_up_is_one_sentence_and_what_it_took_stays(tmp_path):
    path = tmp_path / "run.mcap"
    with child(path, 60_000) as process:
        *_, sentence, closed = process.communicate(timeout=60)[0].splitlines()
        assert process.returncode == 0
    assert sentence == f"{path} is cut short: File too large; what was written is kept"
    assert closed == "closed"
    assert path.stat().st_size <= 60_000
    kept = list(Recording(path).steps())
    assert len(kept) > 3
    assert check_recording(path).exact
