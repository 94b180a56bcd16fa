"""A run with a window beside one without: periods, the loop's own part, and how soon it stops.

Run with::

    pytest tests/benchmarks/test_window.py --benchmark-only -n0
"""

import json
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from urllib.parse import urlsplit

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.stopping import StopRequest
from smarttouch.running.runner import Runner

from ..views.browser import chromium, opened

RATE_HZ = 60
PROGRAM = "import sys; from smarttouch.cli import main; main()"


def live(folder, seconds, *more):
    source = f"text:{'touch what a sensor sees ' * 8}?speed_mm_s=8"
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "live", source, "--seconds", str(seconds),
         "--rate", str(RATE_HZ), "--json", "run.json", "--quiet", *more],
        cwd=folder, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


@pytest.mark.parametrize("pages", [None, 0, 1])
def test_periods(pages, tmp_path, quick, row):
    """None is a run without a window."""
    seconds = 60 if not quick else 4 if pages else 1
    with ExitStack() as stack:
        browser = stack.enter_context(chromium()) if pages else None
        window = () if pages is None else ("--window",)
        run = stack.enter_context(live(tmp_path, seconds, *window))
        if browser is not None:
            address = run.stderr.readline().split()[1]
            page = stack.enter_context(opened(browser, address))
            page.wait_for_selector("#electrodes[data-number]")
            page.wait_for_selector("#stop:disabled", timeout=1000 * (seconds + 60))
            page.close()
        assert run.wait() == 0
    figures = json.loads((tmp_path / "run.json").read_text())
    errors = figures["period_error_us"]
    row(f"Periods at {RATE_HZ} Hz, {seconds} s", {
        "window": "none" if pages is None else f"{pages} pages",
        "sequences": figures["sequences"],
        "late": figures["late_frames"],
        "period off by, p50": f"{errors['p50']:.0f} µs",
        "p99": f"{errors['p99'] / 1000:.2f} ms",
        "most": f"{errors['max'] / 1000:.1f} ms",
        "own work": f"{figures['work_share']:.1%}",
    })  # fmt: skip
    assert figures["emulator_violations"] == 0


def test_part_of_the_loop(profile, quick, row):
    """Time of `Window.step` in the loop's thread, of a scan's."""
    from smarttouch.views.window import Window

    window = Window(StopRequest(), finger=None, show=lambda _: None)
    spent = []

    class Timed(st.Listener):
        prepare, close, event = window.prepare, window.close, window.event

        def step(self, result):
            begun_ns = time.perf_counter_ns()
            window.step(result)
            spent.append((time.perf_counter_ns() - begun_ns) / 1000 / result.sequence.period_us)

    source = st.open_source("text:touch", profile)
    st.run(source, st.open_display("simulated:", profile), listeners=[Timed()])
    share = float(np.percentile(spent, 99))
    row("The window's part of the loop", {"p99 of a scan's time": f"{share:.3%}"})
    assert quick or share < 0.02


def test_stop(profile, quick, row):
    """From the message of a page to the board at zero, on the emulated board."""
    from websockets.sync.client import connect

    from smarttouch.views.window import Window

    took_ms = []
    for _ in range(2 if quick else 20):
        stop, halted = StopRequest(), threading.Event()
        window = Window(stop, finger=None, show=lambda _: None)
        display = st.open_display("emulator:", profile)
        halt = display.board._halt

        def at_zero(halt=halt, halted=halted):
            halt()
            halted.set()

        display.board._halt = at_zero
        flows = threading.Event()

        def watch(result, flows=flows):
            if result.sequence.slots and result.sequence.intensity > 0.2:
                flows.set()

        runner = Runner(
            st.open_source("text:touch what it sees?speed_mm_s=5", profile), display,
            st.RunConfig(), listeners=[window, watch], stop=stop,
        )  # fmt: skip
        thread = threading.Thread(target=runner.run)
        thread.start()
        place = urlsplit(window.address)
        secret = place.path.split("/")[1]
        own = f"http://{place.netloc}"
        with connect(f"ws://{place.netloc}/{secret}/socket", origin=own, proxy=None) as socket:
            assert flows.wait(20)
            begun = time.perf_counter()
            socket.send("stop")
            assert halted.wait(20)
            took_ms.append(1000 * (time.perf_counter() - begun))
        thread.join()
    row("From a page's stop to the board at zero", {
        "median": f"{np.median(took_ms):.1f} ms", "most": f"{max(took_ms):.1f} ms",
    })  # fmt: skip
    assert quick or np.median(took_ms) < 100
