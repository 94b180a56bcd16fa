"""Boards that are asked for what they cannot, and commands of boards with bad options."""

import math
from pathlib import Path

import pytest

from smarttouch.errors import BoardError, DesignError

from .conftest import refused, says


def scale(*arguments):
    return ("board", "calibrate-scale", *arguments)


@pytest.mark.parametrize(("arguments", "wrong"), [
    (("board", "emulate", "optacon"),
     says(about="emulator", value="optacon", allowed=("link", "kajimoto61", "etactilekit"))),
    (("board", "emulate", "link", "--books", "nowhere"),
     says(about="books", value=Path("nowhere"))),
    (("board", "emulate", "link", "--firmware", "newest"),
     says(about="firmware", value="link", allowed=("etactilekit",))),
    (("board", "emulate", "etactilekit", "--firmware", "3"), says(about="firmware", value="3")),
    (("board", "emulate", "link", "--electrodes", "0"),
     says(about="electrodes", value=0, allowed=(1, 1024))),
    (("board", "info", "etactilekit:/dev/x?firmware=3"),
     says(BoardError, "firmware '3'", "936c6c0")),
    (("board", "info", "kajimoto61:"), says(BoardError, "kajimoto61:/dev/ttyUSB0")),
    (("board", "info", "kajimoto61:/dev/nowhere"), says(BoardError, "/dev/nowhere")),
    (("board", "info", "etactilekit:/dev/x?fast"), says(BoardError, "?fast", "?slow", "?firmware")),
    (("board", "info", "kajimoto61:/dev/x", "--profile", "electric-mouse"),
     says(BoardError, "weighted", "one-against-all", remedy="profile kajimoto-61")),
    (("board", "test", "memory:"), says(about="keyboard", remedy="seconds")),
    (("board", "test", "memory:", "--seconds", "0"), says(about="seconds", value=0, allowed=0)),
    (("board", "test", "memory:", "--seconds", "1", "--current-ma", "9"),
     says(about="current_ma", value=9, allowed=pytest.approx(2.4))),
    (("board", "measure", "memory:"), says(BoardError, "measure")),
    (scale("memory:", "--ohm", "0"), says(BoardError, about="ohm", value=0)),
    (scale("memory:", "--ohm", "inf"), says(BoardError, about="ohm", value=math.inf)),
    (scale("memory:", "--current-ma", "nan"), says(BoardError, about="current_ma", value=math.nan)),
    (scale("memory:", "--volts", "-1"), says(BoardError, "-1 V", "1000 ohm")),
    (scale("kajimoto61:x", "--volts", "inf"), says(BoardError, "inf V", "1000 ohm")),
    (scale("kajimoto61:x", "--volts", "nan"), says(BoardError, "nan V", "1000 ohm")),
    (scale("kajimoto61:x", "--volts", "0.001"),
     says(BoardError, "0.001 V", "0.001 times", "30 %", "kV", "µA")),
    (scale("etactilekit:x", "--volts", "1000"),
     says(BoardError, "1000 V", "1e+03 times", "30 %", "mV", "kilohms")),
    (scale("memory:", "--electrode", "64"), says(about="site", value=64, allowed=(0, 63))),
    (("live", "--board", "memory:", "--hold", "power"),
     says(about="hold", value="power", allowed=("charge", "energy"))),
    (("live", "--board", "memory:", "--hold", "charge"), says(BoardError, about="hold")),
    (("live", "--board", "memory:", "--measure"), says(BoardError, "measure")),
    (("live", "--profile", "kajimoto-61", "--board", "memory:", "--mode", "SAI"),
     says(DesignError, "mode SAI", " RA ", " 0.1 ", " 0.0032")),
])  # fmt: skip
def test_bad_input_is_one_sentence(program_here, arguments, wrong):
    wrong(refused(program_here(*arguments)))
