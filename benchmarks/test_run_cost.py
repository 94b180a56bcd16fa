"""Cost of a run on the default path: processing, latency, CPU load, start, and a slow computer.

Each run is a separate process of `smarttouch live` to `emulator:`, with `--scan auto`. CPU load is
that of the program without the emulator, in the last four fifths of the run. To simulate a slow
computer, program and emulator share one core with four processes that only consume CPU time.
"""

import contextlib
import json
import os
import pty
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

PROGRAM = str(Path(sys.executable).with_name("smarttouch"))
TEXT = "text:" + "The quick brown fox jumps over the lazy dog. " * 20
WAYS = {
    "quiet": ["--plain"],
    "screen": [],
    "window": ["--window"],
    "recording": ["--record", "run.mcap"],
}
TICKS = os.sysconf("SC_CLK_TCK")


def seconds_of(quick, seconds):
    return 1.5 if quick else seconds


def cpu_s(pid):
    """Return the CPU time that a process and its threads have used so far, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


@contextlib.contextmanager
def at_a_terminal():
    """Yield a pseudoterminal, and a list whose only item is the number of output bytes so far."""
    master, slave = pty.openpty()
    os.set_blocking(master, True)
    count = [0]

    def drain():
        with contextlib.suppress(OSError):
            while piece := os.read(master, 1 << 16):
                count[0] += len(piece)

    thread = threading.Thread(target=drain, daemon=True)
    thread.start()
    try:
        yield slave, count
    finally:
        os.close(slave)
        thread.join(1)


def ran(folder, seconds, *options, rate_hz=50):
    """Run the program; return its statistics, its CPU load and its terminal output in kB/s."""
    command = [PROGRAM, "live", TEXT, "--board", "emulator:", "--json", "run.json", *options]
    command += ["--set", f"rate_hz={rate_hz}", "--seconds", f"{seconds:g}"]
    environment = os.environ | {"TERM": "xterm-256color", "COLUMNS": "100", "LINES": "30"}
    with at_a_terminal() as (terminal, count):
        process = subprocess.Popen(
            command, stdin=terminal, stdout=terminal, env=environment, cwd=folder
        )
        seen = []
        while process.poll() is None:
            with contextlib.suppress(OSError, IndexError, ValueError):
                seen.append((time.monotonic(), cpu_s(process.pid)))
            time.sleep(0.1)
    assert process.returncode == 0
    at_s, used_s = np.array([each for each in seen if each[1] > 0]).T
    first = int(np.searchsorted(at_s, at_s[-1] - 0.8 * seconds))
    share = (used_s[-1] - used_s[first]) / (at_s[-1] - at_s[first])
    return json.loads((folder / "run.json").read_text()), share, count[0] / seconds / 1000


def quantiles_ms(durations):
    if durations is None:
        return "unknown"
    return " / ".join(f"{durations[key] / 1000:.1f}" for key in ("p50", "p99"))


@pytest.mark.timeout(0)
@pytest.mark.parametrize("rate_hz", [50, 200])
@pytest.mark.parametrize("way", WAYS)
def test_a_run_by_what_follows_it(row, quick, tmp_path, rate_hz, way):
    if quick and (rate_hz, way) not in ((50, "quiet"), (200, "screen")):
        pytest.skip("--quick skips this case")
    seconds = seconds_of(quick, 20)
    found, share, kilobytes = ran(tmp_path, seconds, *WAYS[way], rate_hz=rate_hz)
    work = found["work_us"]
    row(
        "Cost of a run to `emulator:` with `--scan auto`, for each kind of output",
        {
            "requested rate, Hz": rate_hz,
            "output": way,
            "sequences per second": f"{found['rate_hz']:.1f}",
            "CPU load": f"{share:.1%}",
            "processing, µs, p50 / p99": f"{work['p50']:.0f} / {work['p99']:.0f}",
            "last byte to first pulse, ms, p50 / p99": quantiles_ms(found["bytes_to_pulse_us"]),
            "image to first pulse, ms, p50 / p99": quantiles_ms(found["motion_to_pulse_us"]),
            "terminal, kB/s": f"{kilobytes:.0f}",
        },
    )
    assert found["emulator_violations"] == 0
    assert found["motion_to_pulse_us"] is not None


@pytest.mark.timeout(0)
def test_start_to_the_first_sequence(row, quick):
    """The program prints the first line of `--plain` just before the first sequence."""
    command = [PROGRAM, "live", "text:a", "--board", "emulator:", "--plain", "--seconds", "0.1"]
    took_s = []
    for _ in range(1 if quick else 10):
        began_s = time.monotonic()
        with subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL) as process:
            assert b"emulator:" in process.stdout.readline()
            took_s.append(time.monotonic() - began_s)
            process.communicate()
        assert process.returncode == 0
    row(
        "Time from start of the program to its first sequence, s",
        {"minimum": f"{min(took_s):.2f}", "median": f"{statistics.median(took_s):.2f}"},
    )


@contextlib.contextmanager
def busy(processes):
    """Run other processes that only consume CPU time."""
    with contextlib.ExitStack() as stack:
        for _ in range(processes):
            process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.enter_context(process)
            stack.callback(process.kill)
        yield


@pytest.mark.timeout(0)
@pytest.mark.parametrize("way", ["quiet", "screen"])
def test_a_slow_computer(row, quick, tmp_path, way):
    if quick and way != "quiet":
        pytest.skip("--quick skips this case")
    before = os.sched_getaffinity(0)
    # Child processes inherit the CPU affinity.
    os.sched_setaffinity(0, {min(before)})
    try:
        with busy(0 if quick else 4):
            found, share, _ = ran(tmp_path, seconds_of(quick, 30), *WAYS[way])
    finally:
        os.sched_setaffinity(0, before)
    row(
        "Program and emulator on one core with four busy processes, 50 sequences/s requested",
        {
            "output": way,
            "sequences per second": f"{found['rate_hz']:.1f}",
            "CPU load": f"{share:.1%}",
            "image to first pulse, ms, p50 / p99": quantiles_ms(found["motion_to_pulse_us"]),
            "dropped because late": found["dropped_late"],
            "restarts": found["restarts"],
        },
    )
    assert found["emulator_violations"] == 0
