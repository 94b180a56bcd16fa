"""Time that a keeper adds to the way to a board and back."""

import os
import subprocess
import sys
import time
import tty

import numpy as np
import pytest

from smarttouch.base.wire.port import open_port
from smarttouch.boards.kits.kept_line import KeptLine

ECHO = "import os, sys\nwhile data := os.read(0, 4096): os.write(0, data[-1:])"

TITLE = "A keeper between a program and its port"


def spent_us(call, quick):
    """Return cells of how long calls took."""
    spent = []
    for _ in range(20 if quick else 2050):
        start = time.perf_counter()
        call()
        spent.append(1e6 * (time.perf_counter() - start))
    p50, p99 = np.percentile(spent if quick else spent[50:], (50, 99))
    return {"p50, µs": f"{p50:.0f}", "p99, µs": f"{p99:.0f}"}


@pytest.fixture
def port():
    far, near = os.openpty()
    tty.setraw(near)
    with subprocess.Popen([sys.executable, "-c", ECHO], stdin=far) as echo:
        port = open_port(os.ttyname(near))
        yield port
        port.close()
        echo.kill()
    os.close(far)
    os.close(near)


@pytest.mark.parametrize("how", ["port", "keeper"])
@pytest.mark.parametrize("count", [1, 131])
def test_round_trip(row, quick, port, how, count):
    """A ping, and a pattern of 64 electrodes, each answered by one byte."""
    line = KeptLine(port) if how == "keeper" else port
    line.timeout = 1.0
    data = bytes(count)

    def ask():
        line.write(data)
        assert line.read(1) == data[:1]

    row(TITLE, {"": f"{count} bytes and back, {how}"} | spent_us(ask, quick))
    line.close()


def test_flush(row, quick, port):
    """The barrier that a keeper needs before each pattern."""
    line = KeptLine(port)
    row(TITLE, {"": "flush, keeper"} | spent_us(line.reset_input_buffer, quick))
    line.close()
