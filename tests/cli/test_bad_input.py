"""Bad input gets one clear sentence and exit 2, and never a traceback."""

import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
from PIL import Image

from smarttouch.boards.board import make_board
from smarttouch.profile import load_profile
from smarttouch.profile.load import profile_path
from smarttouch.stimulation.safety import SafetyLimits


def png_header(width, height):
    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunk = struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))
    return b"\x89PNG\r\n\x1a\n" + chunk + struct.pack(">I", 0) + b"IDAT" + b"\0\0\0\0"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "text.png").write_text("not an image")
    (tmp_path / "huge.png").write_bytes(png_header(60_000, 60_000))
    (tmp_path / "none.png").write_bytes(png_header(0, 0))
    Image.fromarray(np.zeros((1, 1), np.uint8)).save(tmp_path / "one.png")
    Image.fromarray(np.full((90, 90), 255, np.uint8)).save(tmp_path / "page.png")
    shipped = profile_path("line-7").read_text(encoding="utf-8")
    (tmp_path / "wrong.toml").write_text(f"foo = 1\n{shipped}")
    (tmp_path / "taken.mcap").write_text("precious")
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("live --sensor page:missing.png", "no file missing.png"),
        ("live --sensor page:text.png --dpi 300", "text.png is not an image"),
        ("live --sensor page:huge.png --dpi 300", "above 100 megapixels"),
        ("live --sensor page:none.png --dpi 300", "none.png"),
        ("live --sensor page:one.png --dpi 300", "1 x 1 pixels"),
        ("live --sensor page:page.png", "give --dpi or --page-width-mm"),
        ("live --sensor page:.", "is a folder"),
        ("live --sensor text:", "nothing to print"),
        ("live --sensor radio:5", "unknown sensor 'radio:5'"),
        ("live --profile nobody", "no profile 'nobody'"),
        ("live --profile wrong.toml", "wrong.toml: "),
        ("live --board nobody:", "unknown board 'nobody:'"),
        ("live --board link: --intensity 1", "needs a port"),
        (
            "live --board link:/dev/nothing --intensity 1",
            "cannot open /dev/nothing: there is no such port",
        ),
        ("live --board emulator:7", "takes nothing after the colon"),
        ("live --mode XY", "--mode 'XY' is not offered"),
        ("live --board vibrators:x.wav", "vibrators make no current"),
        ("live --scan frame --hold charge", "choose --scan points"),
        ("live --scan all", "--scan 'all' is not offered"),
        ("live --scan frame --profile kajimoto-61", "cannot be shown at once"),
        ("live --scan frame --profile line-7", "limits.total_ma is not set"),
        ("live --mode color", "--mode 'color' is not offered"),
        ("live --profile kajimoto-61 --mode SAI", "mode SAI is not possible"),
        ("live --rate 0", "a rate of 0 Hz"),
        ("live --rate 1000", "a rate of 1000 Hz"),
        ("live --rate nan", "a rate of nan Hz"),
        ("live --seconds -1", "--seconds -1"),
        ("live --speed 0", "--speed 0"),
        ("live --path missing.csv", "no file missing.csv"),
        ("live --record taken.mcap", "taken.mcap exists"),
        ("live --felt nowhere/felt.png", "cannot write nowhere/felt.png"),
        ("live --json .", "cannot write ."),
        ("live --felt f.png --board link:/dev/nothing", "--felt needs a board"),
        ("design --site 64", "site 64 is out of range"),
        ("design --site -1", "site -1 is out of range"),
        ("design --profile line-7 --mode P", "--mode 'P' is not offered: choose RA or SAI or PC"),
        ("design --profile kajimoto-61 --mode SAI", "mode SAI is not possible"),
    ],
)
def test_one_sentence(program_here, folder, arguments, words):
    done = program_here(*arguments.split(" "))
    assert done.returncode == 2, done.stdout
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("smarttouch: ")
    assert (folder / "taken.mcap").read_text() == "precious"


@pytest.mark.parametrize(
    "arguments", ["live --nonsense", "live --rate abc", "live --seed -1", "nothing"]
)
def test_usage(program_here, arguments):
    done = program_here(*arguments.split(" "))
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_busy_port(program_here, start_emulator):
    _, port, _ = start_emulator()
    with make_board(f"link:{port}", SafetyLimits.of(load_profile("electric-mouse"))):
        done = program_here("live", "--board", f"link:{port}", "--intensity", "1")
    assert done.returncode == 2
    assert f"cannot open {port}: it is in use by another program" in done.stderr
    assert done.stderr.count("\n") == 1


def test_the_profile_of_another_board(program_here, start_emulator):
    _, port, _ = start_emulator(electrodes=16)
    done = program_here("live", "--board", f"link:{port}", "--intensity", "1")
    assert done.returncode == 2
    assert "has 16 electrodes, the profile 64" in done.stderr


def test_help_imports_nothing_heavy():
    code = (
        "import sys, smarttouch.cli;"
        "print([m for m in ('numpy', 'cv2', 'scipy', 'pydantic', 'skimage', 'PIL', 'serial')"
        " if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_help_names_every_command(program_here):
    done = program_here("--help")
    assert done.returncode == 0
    for command in ("live", "profiles", "design"):
        assert command in done.stdout
