"""Detection of lines that delay answers."""

import time
from collections.abc import Callable

SLOW_ANSWER_S = 0.008  # round trip of a slow line: FTDI chips delay input by 16 ms


def slow_line_notes(ask: Callable[[], object]) -> list[str]:
    """Return a note if the line delays answers, by the time that a query takes."""
    times_s = []
    for _ in range(3):
        start = time.perf_counter()
        ask()
        times_s.append(time.perf_counter() - start)
    if min(times_s) <= SLOW_ANSWER_S:
        return []
    return [
        f"the board answers after {1000 * min(times_s):.0f} ms: if its USB chip is an "
        "FTDI, set the port's latency timer to 1 ms"
    ]
