"""Textures from formulas, files and texts."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from PIL import Image

from smarttouch.base.errors import PageError
from smarttouch.instruments.relief import open_texture

from ..support.checks import raises
from ..support.full import sample
from .conftest import grating_file, object_file

ONE = np.zeros((1, 2))
SCALE = "dpi or "
WIDE_MM = 20.0  # value of `grain_mm` at which motion along ridges evokes no pulses


@given(
    pitch=st.floats(0.5, 20),
    angle=st.integers(-180, 180),
    ways=st.lists(st.tuples(st.floats(-30, 30), st.floats(-30, 30)), min_size=1, max_size=8),
)
def test_ridges_of_a_grating_are_where_they_are(pitch, angle, ways):
    """The change of the phase's integer part is the number of ridges that the finger passes."""
    texture = open_texture(f"grating:{pitch}mm,{angle}deg")
    position = np.array([[0.3, 0.7], [-5.1, 2.2], [7.3, -7.9]])
    feeler = texture.feeler(position)
    unit = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    feeler.place(0, 0)
    before = np.floor(position @ unit / pitch)
    for x, y in ways:
        phase = (position + np.array([x, y])) @ unit / pitch
        # Skip places on a ridge, because rounding decides on which side of the ridge they are.
        assume((np.abs((phase + 0.5) % 1 - 0.5) > 1e-6).all())
        height, merged = feeler.move(x, y)
        ridges = np.abs(np.floor(phase) - before)
        assert height.tolist() == (ridges > 0).tolist()
        assert merged == np.maximum(ridges - 1, 0).sum()
        before = np.floor(phase)


def test_a_grating_is_drawn_where_it_is_felt():
    drawn = open_texture("grating:4mm,90deg").draw(-2.0, -1.0, (60, 20), 0.1)
    assert np.ptp(drawn, axis=1).max() == 0
    dark = np.flatnonzero(drawn[:, 0] < 20) * 0.1 - 1.0
    # Ridges at 0 and 4 mm.
    assert {round(each) for each in dark} == {0, 4}
    slanted = open_texture("grating:3mm,30deg").draw(5.0, 7.0, (40, 50), 0.2)
    y, x = np.mgrid[:40, :50] * 0.2 + 0.1
    phase = ((x + 5) * math.cos(math.pi / 6) + (y + 7) * 0.5) / 3
    assert np.abs(slanted - 127.5 * (1 - np.cos(2 * np.pi * phase))).max() < 8


def crests(texture, start, step, count, electrodes=ONE):
    """Move in steps. Return x in mm, y in mm and the texture's height for each pulse, (N, 3)."""
    feeler = texture.feeler(electrodes)
    place = np.array(start, float)
    feeler.place(*place)
    found = []
    for _ in range(count):
        place = place + step
        height = feeler.move(*place).height
        found += [(*(place + electrodes[k]), height[k]) for k in np.flatnonzero(height)]
    return np.array(found).reshape(-1, 3)


@pytest.mark.parametrize("step", sample([0.4, 0.05, 1.1], 3))
@pytest.mark.parametrize("kind", ["square", "thin"])
def test_a_grating_in_an_image_pulses_on_its_ridges(tmp_path, kind, step):
    texture = open_texture(str(grating_file(tmp_path / "g.png", 0, kind)))
    for way in (1, -1):
        start = 6.0 if way > 0 else 86.0
        found = crests(texture, (start, 20), (way * step, 0), int(80 / step))
        assert len(found) == 20
        late = (found[:, 0] + 2) % 4 - 2
        assert (way * late).min() > -0.2
        assert (way * late).max() < step + 0.4
        assert found[:, 2].min() > 0.9


def test_along_its_ridges_a_grating_with_a_wide_grain_is_silent(tmp_path):
    texture = open_texture(str(grating_file(tmp_path / "g.png", 0)), grain_mm=WIDE_MM)
    across = np.column_stack([np.linspace(-8, 8, 9), np.zeros(9)])
    assert len(crests(texture, (40, 4), (0, 0.4), 80, across)) == 0


def test_an_area_is_felt_all_over(tmp_path):
    """By default, the first pulse is 1 mm inside an area's edge; a pulse every 2 mm follows."""
    texture = open_texture(str(object_file(tmp_path / "o.png", "disc")))
    found = crests(texture, (20, 20), (0.1, 0), 400)
    assert found[:, 0] == pytest.approx([36, 38, 40, 42, 44], abs=0.25)
    assert (found[:, 2] == 1).all()
    finer = open_texture(str(tmp_path / "o.png"), grain_mm=1.0)
    assert len(crests(finer, (20, 20), (0.1, 0), 400)) == 10
    assert len(crests(texture, (20, 27), (0.4, 0), 100)) == 0


@pytest.mark.parametrize("angle", [45, 75])
def test_a_ridge_passed_obliquely_is_one_ridge(tmp_path, angle):
    path = grating_file(tmp_path / "g.png", angle, "faint", noise=5)
    texture = open_texture(str(path), grain_mm=WIDE_MM)
    rows = np.column_stack([np.zeros(15), np.linspace(-14, 14, 15)])
    found = crests(texture, (2, 20), (0.4, 0), 200, rows)
    wanted = 15 * 80 / 4 * math.cos(math.radians(angle))
    assert len(found) == pytest.approx(wanted, rel=0.05)


def test_a_hand_that_trembles_in_an_area_gets_nothing(tmp_path):
    texture = open_texture(str(object_file(tmp_path / "o.png", "disc")))
    feeler = texture.feeler(ONE)
    feeler.place(40, 20)
    random = np.random.default_rng(3)
    for x, y in random.uniform(-0.9, 0.9, (500, 2)):
        assert not feeler.move(40 + x, 20 + y).height.any()


def test_bright_parts_of_a_deep_image_may_be_high(tmp_path):
    y, x = np.mgrid[:200, :300] * 0.1
    height = np.rint(500 + 250 * np.cos(2 * np.pi * x / 3) + 0 * y).astype(np.uint16)
    Image.fromarray(height).save(tmp_path / "h.png")
    for light, first in ((True, 3), (False, 1.5)):
        texture = open_texture(str(tmp_path / "h.png"), width_mm=30, light_on_dark=light)
        assert texture.size_mm == pytest.approx((30, 20))
        found = crests(texture, (0.1, 10), (0.2, 0), 120)
        assert found[:, 0] == pytest.approx(np.arange(first, 24, 3), abs=0.5)


@pytest.mark.parametrize(("spec", "options", "attributes"), [
    *((spec, {}, {"value": spec}) for spec in ("grating:", "grating:4cm")),
    *((name, {}, {"value": Path(name)}) for name in ("none.png", "words.png")),
    ("grating:0.01mm", {}, {"value": 0.01}),
    ("grating:4mm,400deg", {}, {"value": 400, "allowed": (-360, 360)}),
    ("grating:4mm", {"width_mm": 10}, {"value": "grating:4mm"}),
    ("text: ", {}, {}), ("text:a", {"dpi": 100}, {}),
    ("o.png", {"dpi": 100, "width_mm": 20}, {}),
    ("o.png", {"grain_mm": 0.0}, {"value": 0}),
    ("o.png", {"width_mm": 1e5}, {"names": SCALE}),
    ("flat.png", {"dpi": 100}, {"value": "flat.png"}),
    ("unscaled.png", {}, {"value": Path("unscaled.png"), "names": SCALE}),
])  # fmt: skip
def test_errors_are_reported(tmp_path, monkeypatch, spec, options, attributes):
    monkeypatch.chdir(tmp_path)
    object_file(tmp_path / "o.png", "disc")
    Image.fromarray(np.full((40, 40), 99, np.uint8)).save("flat.png")
    Image.fromarray(np.eye(40, dtype=np.uint8)).save("unscaled.png")
    (tmp_path / "words.png").write_text("words")
    with raises(PageError, **attributes):
        open_texture(spec, **options)
