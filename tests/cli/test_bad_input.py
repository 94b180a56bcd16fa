"""Bad input gets one clear sentence and exit 2, and never a traceback."""

import inspect
import os
import random
import signal
import socket
import struct
import subprocess
import typing
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from smarttouch.base.errors import (
    BoardError,
    PageError,
    ProfileError,
    RecordingError,
    ScheduleError,
    SmartTouchError,
    SourceError,
)
from smarttouch.cli import app
from smarttouch.profile.toml_files import profile_path

from ..support.full import WHOLE
from ..support.processes import PROGRAM, Forked
from .conftest import refused, says

pytestmark = pytest.mark.usefixtures("patient_boards")


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
    ("devices emulate link?books=nowhere", says(value=Path("nowhere"))),
    ("devices emulate link?firmware=newest",
     says(value="link", allowed=("etactilekit",))),
    ("devices emulate etactilekit?firmware=3", says(value="3")),
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
    ("calibrate scale memory: --volts 1 --ohm 0", says(BoardError, value=0)),
    ("calibrate scale memory: --volts -1", says(BoardError, "volts", value=-1)),
    ("calibrate scale kajimoto61:x --volts 0.001",
     says(BoardError, "0.001 V", "0.001 times", "30 %")),
    ("live --board memory: --set hold=charge", says(BoardError)),
    ("live --board memory: --set hold=power",
     says(value="power", allowed=("charge", "energy"))),
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


NUMBERS = (
    "nan", "inf", "-inf", "-1", "0", "-0.0", "1", "0.5", "3", "1e30", "-1e30", "1e-30", "1e308",
    "1e400", "", " ", "9" * 30, "-" + "9" * 30, "9" * 5000, "2147483648", "65536", "１",
)  # fmt: skip


def free_port():
    """Return a free TCP port of this machine."""
    with socket.create_server(("127.0.0.1", 0)) as one:
        return one.getsockname()[1]


SMALL = "--profile smarttouch-4x4"
PAGE = "--seconds 0.2 --board memory:"
BASES = {
    "live": f"live text:i {SMALL} {PAGE}",
    "read": f"read text:i {SMALL} {PAGE}",
    "braille": "braille hello",
    "braille-display": f"braille-display {free_port()} {SMALL} {PAGE}",
    "replay": f"replay {{golden}} {PAGE}",
    "design": "design --profile line-7",
    "profiles new": "profiles new mine.toml --grid 2x2 --overwrite",
    "experiment run": (
        "experiment run detection?trials=1&procedure=questplus --simulate random --subject x"
    ),
    "experiment fit": "experiment fit {answers}",
    "devices test": "devices test emulator: --profile line-7 --seconds 0.05 --current-ma 0.5",
    "calibrate scale": "calibrate scale emulator: --volts 1 --ohm 1000",
    "devices show": "devices show text:i --seconds 0.1",
    "calibrate force": "calibrate force --cell loadcell:none --output mine.toml --overwrite",
}
"""A command line of each command that has numbers, to which one is added."""

PATIENCE_S = 2
ENDING_S = 10


def commands(typer_app, path=()):
    for each in typer_app.registered_commands:
        yield " ".join((*path, each.name or each.callback.__name__.replace("_", "-"))), each
    for each in typer_app.registered_groups:
        yield from commands(each.typer_instance, (*path, each.name))


def numeric_options(command):
    hints = typing.get_type_hints(command.callback, include_extras=True)
    for name in inspect.signature(command.callback).parameters:
        kind, *notes = typing.get_args(hints[name]) or (hints[name],)
        if {int, float} & {kind, *typing.get_args(kind)}:
            declared = [each for note in notes for each in getattr(note, "param_decls", None) or ()]
            yield next(iter(declared), "--" + name.replace("_", "-"))


OPTIONS = [(name, each) for name, found in commands(app) for each in numeric_options(found)]


def test_every_command_with_numbers_is_tried():
    assert {name for name, _ in OPTIONS} == set(BASES)
    assert len(OPTIONS) > 20


def one_run(folder, arguments, patience_s=PATIENCE_S):
    """Return exit status and errors of a run, and how often one that goes on was interrupted."""
    streams = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    with Forked(
        [PROGRAM, *arguments], cwd=folder, stdin=subprocess.DEVNULL, start_new_session=True,
        text=True, errors="replace", **streams,
    ) as process:  # fmt: skip
        # Twice, as anyone would: this is not the test of what a single Ctrl-C does.
        for interrupted, wait_s in enumerate((patience_s, ENDING_S, ENDING_S)):
            try:
                out, err = process.communicate(timeout=wait_s)
            except subprocess.TimeoutExpired:
                # As a terminal does; in the end whatever it takes.
                os.killpg(process.pid, signal.SIGINT if interrupted < 2 else signal.SIGKILL)
            else:
                assert "Traceback" not in out, (arguments, out)
                return process.returncode, err, interrupted
    raise AssertionError(f"it could not be interrupted: {arguments}")


def assert_in_order(arguments, code, err, interrupted):
    """Check that a run did nothing that no run may do."""
    done = arguments, code, err
    for sign in ("Traceback", "internal error", "Warning", "Exception"):
        assert sign not in err, done
    assert code in ((0, 130) if interrupted else (0, 2)), done
    assert err or code != 2, done
    assert not err.startswith("smarttouch: ") or err.count("\n") == 1, done


@pytest.mark.timeout(0)
def test_numbers(tmp_path, runs):
    """Of all pairs of an option and a number, so many."""
    pairs = [(name, option, each) for name, option in OPTIONS for each in NUMBERS]
    chosen = random.Random(12).sample(pairs, min(runs or (12 if WHOLE else 6), len(pairs)))
    answers = tmp_path / "answers.csv"
    answers.write_text("standard,comparison,success\n" + "1,0.5,0\n1,1,1\n1,2,1\n" * 9)
    golden = Path(__file__).parent.parent / "running" / "goldens" / "ra.mcap"
    bases = {
        name: base.format(golden=golden, answers=answers).split() for name, base in BASES.items()
    }
    for name, base in bases.items():
        if name in {name for name, _, _ in chosen}:
            code, err, interrupted = one_run(tmp_path, base, 100)
            # Where the device is missing, it ends before the numbers count.
            assert (code, interrupted) == (2 * (name == "calibrate force"), 0), (base, err)
            assert_in_order(base, code, err, interrupted)
    for name, option, number in chosen:
        base = list(bases[name])
        if option in base:
            at = base.index(option)
            del base[at : at + 2]
        arguments = [*base, f"{option}={number}"]
        assert_in_order(arguments, *one_run(tmp_path, arguments))
