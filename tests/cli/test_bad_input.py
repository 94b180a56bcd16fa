"""Tests that bad input ends the program with exit code 2 and a message of one line."""

import math
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from smarttouch.base.errors import (
    BoardError,
    DesignError,
    PageError,
    ProfileError,
    RecordingError,
    ScheduleError,
    SmartTouchError,
    SourceError,
)
from smarttouch.profile.toml_files import profile_path

from .conftest import refused, says


def png_header(width, height):
    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunk = struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))
    return b"\x89PNG\r\n\x1a\n" + chunk + struct.pack(">I", 0) + b"IDAT" + b"\0\0\0\0"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "huge.png").write_bytes(png_header(60_000, 60_000))
    Image.fromarray(np.full((90, 90), 255, np.uint8)).save(tmp_path / "page.png")
    shipped = profile_path("line-7").read_text(encoding="utf-8")
    (tmp_path / "wrong.toml").write_text(f"foo = 1\n{shipped}")
    (tmp_path / "taken.mcap").write_text("precious")
    (tmp_path / "taken.wav").write_text("precious")
    return tmp_path


def no_file(kind, name):
    return says(kind, value=Path(name))


def no_choice(option, value, *allowed):
    return says(value=value, allowed=allowed)


def no_place(name):
    return says(value=Path(name))


@pytest.mark.parametrize(("arguments", "wrong"), [
    ("live page:missing.png", no_file(PageError, "missing.png")),
    ("live page:huge.png?dpi=300", says(PageError, "huge.png", "100 megapixels")),
    ("live radio:5", says(SourceError, value="radio:5")),
    ("live --profile nobody", says(ProfileError, "'nobody'", "electric-mouse")),
    ("live --profile wrong.toml", says(ProfileError, "wrong.toml", key="foo")),
    ("live --board nobody:", says(BoardError, value="nobody:")),
    ("live --board link: --intensity 1", says(BoardError, "link: ", "link:/dev/ttyACM0")),
    ("live --board link:/dev/nothing --intensity 1", says(BoardError, "/dev/nothing")),
    ("live --set vibrators=x.mp3", says(SmartTouchError, "x.mp3", "sound:")),
    ("live --set vibrators=taken.wav", says(SmartTouchError, "taken.wav")),
    ("live --set vibrators=x.wav --mode PC", says(SmartTouchError, "mode PC", "vibrator")),
    ("live --set scan=frame", no_choice("scan", "frame", "auto", "points")),
    ("live --mode color", no_choice("mode", "color", "RA", "SAI", "PC", "natural")),
    ("live --set rate_hz=1000", says(ScheduleError, " 1000 Hz", "200 Hz")),
    ("live --set rate_hz=nan", says(ScheduleError, " nan Hz", "200 Hz")),
    ("live --seconds -1", says(value=-1, allowed=0)),
    ("live text:i?speed_mm_s=0",
     says(SourceError, value=0, allowed=(0.1, 500))),
    ("live --record taken.mcap", says(RecordingError, "taken.mcap")),
    ("live --felt nowhere/felt.png", no_place("nowhere/felt.png")),
    ("live --json .", no_place(".")),
    ("live --felt f.png --board link:/dev/nothing --intensity 1", says()),
    ("devices emulate optacon",
     says(value="optacon", allowed=("link", "kajimoto61", "etactilekit"))),
    ("devices emulate link?volts", says(value="?volts")),
    ("devices show etactilekit:/dev/x?firmware=3", says(BoardError, "firmware '3'", "71adee2")),
    ("devices show kajimoto61:/dev/x --profile electric-mouse",
     says(BoardError, "weighted", "one-against-all")),
    ("devices test memory:", says()),
    ("devices test link:/dev/nowhere --seconds 1", says(value=0.5)),
    ("devices test memory: --seconds 0 --current-ma 0.5", says(value=0, allowed=0)),
    ("devices test memory: --seconds 1 --current-ma 9",
     says(value=9, allowed=pytest.approx(2.4))),
    ("devices test memory: --electrode 64", says(value=64, allowed=(0, 63))),
    ("devices measure memory:", says(BoardError, "measure")),
    ("calibrate scale kajimoto61:x --volts 0.001",
     says(BoardError, "0.001 V", "0.001 times", "30 %")),
    ("live --board memory: --set hold=charge", says(BoardError)),
    ("live --board memory: --set hold=power",
     says(value="power", allowed=("charge", "energy"))),
    ("live --intensity 1.2", says(value=1.2, allowed=(0, 1))),
    ("live --set softness=nan", says(value=math.nan, allowed=(0, 1))),
    ("live camera:0?size=640", says(SourceError, "size", "640x480")),
    ("live text:a?exposure=3", says(SourceError, " exposure:", "speed_mm_s")),
    ("live --mode natural --set rate_hz=50",
     says(ScheduleError, "rate_hz=50", "pulse.ra_rate_hz", "pulse.sai_rate_hz")),
    ("live --force cell:", says(SourceError, value="cell:")),
    ("design 7 --profile=line-7", says(value=7, allowed=(0, 6))),
    ("design --mode=PA", says(value="PA", allowed=("RA", "SAI", "PC"))),
    ("design --profile=kajimoto-61 --mode=SAI",
     says(DesignError, value="SAI", allowed=("RA",))),
    ("design --plot=k.jpg --profile=line-7", says(SmartTouchError, "k.jpg", "end in .png")),
    ("devices show text:x --seconds 0", says(value=0, allowed=(0, 3600))),
    ("devices show hx711:/dev/nowhere",
     says(SourceError, "electric-mouse", "force.curve", "0.00980665")),
])  # fmt: skip
def test_one_sentence(program_here, folder, arguments, wrong):
    wrong(refused(program_here(*arguments.split(" "))))
    assert (folder / "taken.mcap").read_text() == "precious"


@pytest.mark.parametrize(
    "arguments", ["live --nonsense", "live --set rate_hz=abc", "live --set seed=-1", "nothing"]
)
def test_usage(program_here, arguments):
    done = program_here(*arguments.split(" "))
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
