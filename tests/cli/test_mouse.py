"""The electric mouse, through ``smarttouch live texture:``."""

from importlib.util import find_spec

import pytest
from PIL import Image

from smarttouch.base.errors import PageError, SourceError

from ..instruments.touched import object_file
from .conftest import refused, says


@pytest.fixture
def stroke(program_here):
    """Return a runner over a texture that gives its figures, and all that was ``printed``."""

    def run(texture, words=""):
        live = f"live 'texture:{texture}' --board simulated: --json f.json"
        done = program_here(f"{live} {words}").flawless()
        return done.figures | {"printed": done.stdout}

    return run


def test_without_options_a_virtual_hand_strokes_a_grating(stroke, tmp_path):
    figures = stroke("", "--intensity 0.5 --felt felt.png --finger paper")
    # 60 mm there and back over 4 mm: 15 ridges each, at all of 64 electrodes.
    assert figures["slots"] == pytest.approx(2 * 15 * 64, abs=64)
    assert figures["emulator_violations"] == 0
    assert figures["ended"] == "the hand has stopped"
    with Image.open(tmp_path / "felt.png") as picture:
        assert picture.width > 900


def test_an_image_under_a_recorded_hand(stroke, tmp_path):
    object_file(tmp_path / "o.png", "disc")
    (tmp_path / "way.csv").write_text(
        "time_s,x_mm,y_mm,force_n\n0,20,20,1\n1,20,20,1\n2,60,20,1\n2.1,60,20,1\n"
    )
    hand = "motion=path:way.csv"
    all_over = stroke(f"o.png?{hand}", "--quiet")["slots"]
    assert 100 < all_over < 250
    twice = stroke(f"o.png?grain_mm=1&{hand}", "--quiet --mode SAI")["slots"]
    assert twice == pytest.approx(2 * all_over, rel=0.2)
    assert stroke(f"o.png?{hand}", "--quiet --force fixed:0.1")["slots"] == 0


@pytest.mark.parametrize(("arguments", "wrong"), [
    ("grating:x", says(PageError, "'grating:x'", "grating:4mm,30deg")),
    ("?motion=evdev:/dev/null",
     says(SourceError, "/dev/null" if find_spec("evdev") else "smarttouch[mouse]")),
    (" --rate 300", says(SourceError, about="rate_hz", value=300, allowed=(10, 200))),
    (" --mode natural",
     says(SourceError, about="mode", value="natural", allowed=("RA", "SAI", "PC"))),
])  # fmt: skip
def test_bad_input_is_one_sentence(program_here, arguments, wrong):
    wrong(refused(program_here(f"live texture:{arguments} --board simulated:")))
