"""From a program's write to BrlAPI to the first pulse of what it wrote, with a real BRLTTY."""

import threading
import time

import numpy as np
import pytest

import smarttouch as st
from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.reading.brltty import BrailleDisplaySource
from tests.reading.real_brltty import Brltty, free_port, require_brltty, wait_until

HANGS_S = 120
SHOWN_S = 0.2


class Pulses(st.Listener):
    """Keeps when the first pulses of each update went out."""

    def __init__(self, source):
        super().__init__()
        self._source = source
        self.sent_ns = {}
        self.first = threading.Event()

    def step(self, result):
        if result.sequence.slots:
            self.sent_ns.setdefault(_shown(self._source), time.perf_counter_ns())
            self.first.set()


def _shown(source):
    """Return the number of what is shown; 0 before the first."""
    return source.shown.number if source.shown else 0


@pytest.mark.parametrize("board", ["emulator:"])
def test_a_write_is_felt(row, quick, tmp_path, board):
    require_brltty()
    profile = profile_for_reading(st.load_profile("electric-mouse"))
    source = BrailleDisplaySource(str(free_port()), profile, cells=6)
    real = Brltty(f"client:{':'.join(map(str, source.address))}", tmp_path)
    real.start()
    late_ms = []
    with real.writer() as writer, st.open_display(board, profile) as display:
        pulses = Pulses(source)
        run = threading.Thread(
            target=lambda: st.run(source, display, mode="RA", listeners=[pulses])
        )
        run.start()
        writer.write("rising")
        assert pulses.first.wait(HANGS_S)
        for count in range(5 if quick else 200):
            number = _shown(source)
            begun_ns = time.perf_counter_ns()
            writer.write("abcdef"[count % 5 :])
            assert wait_until(lambda number=number: _shown(source) > number, HANGS_S)
            time.sleep(SHOWN_S)
            sent_ns = pulses.sent_ns.get(number + 1)
            if sent_ns is not None:
                late_ms.append((sent_ns - begun_ns) / 1e6)
        display.stop()
        run.join(HANGS_S)
    real.kill()
    source.close()
    assert late_ms
    p50, p99 = np.percentile(late_ms, [50, 99])
    row(
        "From BrlAPI to the first pulse",
        {"board": board, "writes": len(late_ms), "p50, ms": f"{p50:.1f}", "p99, ms": f"{p99:.1f}"},
    )
