"""Latency of the stop button on the window's page."""

import threading
import time
from urllib.parse import urlsplit

import numpy as np

import smarttouch as st
from smarttouch.base.stopping import StopRequest
from smarttouch.running.runner import Runner


def test_stop(profile, quick, row):
    """The median time from the page's stop message until the board is at zero is below 0.1 s."""
    from websockets.sync.client import connect

    from smarttouch.views.window import Window

    took_ms = []
    for _ in range(2 if quick else 20):
        stop, halted = StopRequest(), threading.Event()
        window = Window(stop, show=lambda _: None)
        display = st.open_display("emulator:", profile)
        halt = display.board.driver.zero

        def at_zero(halt=halt, halted=halted):
            halt()
            halted.set()

        display.board.driver.zero = at_zero
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
    row("Time from a page's stop message to the board at zero", {
        "median": f"{np.median(took_ms):.1f} ms", "maximum": f"{max(took_ms):.1f} ms",
    })  # fmt: skip
    assert quick or np.median(took_ms) < 100
