"""A program that is killed, or has its disk filled, loses nothing that the system was given."""

import errno
import os
import random
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from smarttouch.running.check_recording import check_recording
from smarttouch.running.recording import RecordedRun

from ..whole import WHOLE

CHILD = Path(__file__).with_name("recorded_child.py")
KILLS = int(os.environ.get("SMARTTOUCH_KILLS", "2" if WHOLE else "1"))


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
    draw, told = random.Random(seed), []
    with child(path) as process:
        # At any time after the first few flushes, in whatever it does then.
        while sum(given > 0 for _, given in told) < 3:
            told.append([int(each) for each in process.stdout.readline().split()])
        time.sleep(draw.uniform(0.0, 0.5))
        process.kill()
        told += [[int(each) for each in line.split()] for line in process.stdout]
    last_ns, given = (max(each) for each in zip(*told, strict=True))
    kept = list(RecordedRun(path).steps())
    lost_ms = (last_ns - kept[-1].step.input.time_ns) / 1e6
    print(f"killed at {last_ns / 1e6:.0f} ms: {lost_ms:.1f} ms lost")
    assert [each.index for each in kept] == list(range(len(kept)))
    # What the system was given is kept; how soon it is given is asked of a clock that is told.
    assert len(kept) >= given > 2
    assert not RecordedRun(path).whole
    check = check_recording(path)
    assert check.exact, check.describe()
    assert check.left_out


def test_a_disk_that_fills_up_is_one_sentence_and_what_it_took_stays(tmp_path):
    path = tmp_path / "run.mcap"
    with child(path, 600_000) as process:
        *_, sentence, closed = process.communicate(timeout=110)[0].splitlines()
        assert process.returncode == 0
    assert sentence.startswith(f"{path} ")
    assert os.strerror(errno.EFBIG) in sentence
    assert closed == "closed"
    assert path.stat().st_size <= 600_000
    kept = list(RecordedRun(path).steps())
    assert [each.index for each in kept] == list(range(len(kept)))
    assert len(kept) > 3
    assert check_recording(path).exact
