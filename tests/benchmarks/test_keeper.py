"""What a keeper adds to the way to a board and back."""

import os
import subprocess
import sys
import tty

import pytest

from smarttouch.boards.kept_line import KeptLine
from smarttouch.wire.port import open_port

ECHO = "import os, sys\nwhile data := os.read(0, 4096): os.write(0, data[-1:])"


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
def test_round_trip(benchmark, port, how, count):
    """A ping, and a pattern of 64 electrodes, each answered by one byte."""
    line = KeptLine(port) if how == "keeper" else port
    line.timeout = 1.0
    data = bytes(count)

    def ask():
        line.write(data)
        assert line.read(1) == data[:1]

    benchmark.pedantic(ask, rounds=2000, warmup_rounds=50)
    line.close()


def test_flush(benchmark, port):
    """The barrier that a keeper needs before each pattern."""
    line = KeptLine(port)
    benchmark.pedantic(line.reset_input_buffer, rounds=2000, warmup_rounds=50)
    line.close()
