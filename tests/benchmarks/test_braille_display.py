"""From a program's write to BrlAPI to the first pulse of what it wrote, with a real BRLTTY."""

import threading
import time

import numpy as np
import pytest

import smarttouch as st
from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.reading.brltty import BrailleDisplaySource, BrlttyConnection
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
            self.sent_ns.setdefault(self._source.update, time.perf_counter_ns())
            self.first.set()


def _shown(connection):
    """Return the number of what is shown; 0 before the first."""
    return connection.shown.number if connection.shown else 0


@pytest.mark.parametrize("board", ["emulator:"])
def test_a_write_is_felt(row, quick, tmp_path, board):
    require_brltty()
    profile = profile_for_reading(st.load_profile("electric-mouse"))
    connection = BrlttyConnection(str(free_port()), 6).open()
    real = Brltty(f"client:{connection}", tmp_path)
    real.start()
    late_ms = []
    source = BrailleDisplaySource(connection, profile)
    with real.writer() as writer, st.open_display(board, profile) as display:
        pulses = Pulses(source)
        run = threading.Thread(
            target=lambda: st.run(source, display, mode="RA", listeners=[pulses])
        )
        run.start()
        writer.write("rising")
        assert pulses.first.wait(HANGS_S)
        for count in range(5 if quick else 200):
            number = _shown(connection)
            begun_ns = time.perf_counter_ns()
            writer.write("abcdef"[count % 5 :])
            assert wait_until(lambda number=number: _shown(connection) > number, HANGS_S)
            time.sleep(SHOWN_S)
            sent_ns = pulses.sent_ns.get(number + 1)
            if sent_ns is not None:
                late_ms.append((sent_ns - begun_ns) / 1e6)
        display.stop()
        run.join(HANGS_S)
    real.kill()
    connection.close()
    assert late_ms
    p50, p99 = np.percentile(late_ms, [50, 99])
    row(
        "From BrlAPI to the first pulse",
        {"board": board, "writes": len(late_ms), "p50, ms": f"{p50:.1f}", "p99, ms": f"{p99:.1f}"},
    )
