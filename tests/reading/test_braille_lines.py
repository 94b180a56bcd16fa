"""Braille lines of texts and files: distances of dots, and cells decoded from pulses."""

import shutil
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from smarttouch.base.errors import BrailleError, PageError, ReadingError
from smarttouch.braille.brf import format_brf
from smarttouch.braille.cells import dots_to_cells
from smarttouch.braille.code_tables import open_table
from smarttouch.imaging.image_reconstruction import PIXELS_PER_PITCH
from smarttouch.imaging.reading_profile import profile_for_reading
from smarttouch.kernels.bank import load_bank
from smarttouch.pages.prepared_page import print_text
from smarttouch.profile import load_profile
from smarttouch.reading.braille_lines import (
    CELL_MM,
    DOT_MM,
    Braille,
    cell_layout,
    document_cells,
)
from smarttouch.reading.legibility import LineDelivery, deliver_pulses
from smarttouch.reading.reading_material import ReadingMaterial
from smarttouch.reading.recognition import RecognitionOptions

from ..support.checks import raises
from ..support.full import WHOLE, sample

ARRAYS = ["electric-mouse", "etactilekit-32", "optacon-24x6", "smarttouch-4x4"]


@cache
def array(name):
    profile = profile_for_reading(load_profile(name))
    return profile, load_bank(profile)


@pytest.mark.parametrize("name", ARRAYS)
def test_distances_are_the_nearest_that_electrodes_have(name):
    layout = cell_layout(load_profile(name))
    for count, wanted_mm, pitch_mm in (
        (layout.dot_x, DOT_MM, layout.pitch_mm[0]),
        (layout.dot_y, DOT_MM, layout.pitch_mm[1]),
        (layout.cell, CELL_MM, layout.pitch_mm[0]),
    ):
        assert abs(count * pitch_mm - wanted_mm) <= pitch_mm / 2


def test_each_dot_is_one_electrode(reading):
    line = cell_layout(reading).line("⠓⠊")
    dots = line.image.reshape(8, 8, -1, 8).mean(axis=(1, 3)) < 128
    wanted = np.zeros((8, 6), bool)
    for row, column in ((2, 0), (3, 0), (3, 1), (3, 3), (2, 4)):
        wanted[row, column] = True
    np.testing.assert_array_equal(dots, wanted)
    assert set(np.unique(line.image)) == {0, 255}
    assert Braille().motion(reading, 30.0).step_mm == 2.0


def cells(last):
    return st.text(st.characters(min_codepoint=0x2800, max_codepoint=last), min_size=1, max_size=9)


def delivered(name, line, eight=False):
    profile, bank = array(name)
    layout = cell_layout(profile, eight)
    shown = layout.line(line)
    # The finger moves fast, because one pulse at each position is enough to decode cells.
    motion = Braille().motion(profile, profile.electrodes.cell_mm[0] * 20)
    picture = deliver_pulses(shown, LineDelivery(profile, bank, Braille().tone, motion)).picture
    dots = 8 if eight else 6
    rows, columns = layout.dots_of(dots_to_cells(np.ones((len(line), dots), bool)))
    across, down = layout.pitch_mm
    pixel_mm = min(profile.electrodes.cell_mm) / PIXELS_PER_PITCH
    places = [np.int64((k + 0.5) * mm / pixel_mm) for k, mm in ((rows, down), (columns, across))]
    on = picture.values()[tuple(places)] > 0.5
    return dots_to_cells(on.reshape(len(line), dots))


@pytest.mark.parametrize("name", sample(ARRAYS))
@settings(max_examples=6 if WHOLE else 2, deadline=None)
@given(six=cells(0x283F), eight=cells(0x28FF))
def test_what_is_delivered_is_what_was_asked_for(name, six, eight):
    assert delivered(name, six) == six
    if name in ("electric-mouse", "optacon-24x6"):
        assert delivered(name, eight, eight=True) == eight


@pytest.mark.parametrize(("name", "attributes"), [
    ("line-7", {"value": (1, 7), "allowed": (3, 3)}), ("kajimoto-61", {"value": "kajimoto-61"}),
    ("line-8", {"value": (1, 8)}),
])  # fmt: skip
def test_arrays_without_room_are_named(name, attributes):
    with raises(ReadingError, **attributes):
        cell_layout(load_profile(name))


def load(name, notes=None, **options):
    notes = [] if notes is None else notes
    material = ReadingMaterial(str(name), RecognitionOptions(**options), notes.append)
    return document_cells(material, open_table("en-1"), notes.append)


@pytest.mark.parametrize(("text", "paragraphs"), [
    ("Go\n\nthere", ["⠠⠛⠕", "", "⠞⠓⠑⠗⠑"]), ("⠁⠃ ⣿\n⠉", ["⠁⠃⠀⣿", "⠉"]),
])  # fmt: skip
def test_a_text_becomes_cells_and_cells_stay(reading, text, paragraphs):
    assert load(f"text:{text}").paragraphs == paragraphs
    lines = list(Braille().lines(ReadingMaterial(f"text:{text}"), reading))
    assert [line.cells for line in lines] == [each for each in paragraphs if each]
    assert [line.text for line in lines] == [each for each in text.split("\n") if each]


def test_a_brf_file_keeps_its_pages_until_it_is_laid_out_anew(reading, tmp_path):
    pages = [["⠀⠀⠁⠃", "⠉"], ["⠀⠀⠙"]]
    (tmp_path / "a.brf").write_bytes(format_brf(pages))
    cells = load(tmp_path / "a.brf")
    assert cells.paragraphs == ["⠁⠃⠀⠉", "⠙"]
    assert cells.laid_out(None, None) == pages
    assert cells.laid_out(10, 1) == [["⠀⠀⠁⠃⠀⠉"], ["⠀⠀⠙"]]
    lines = Braille().lines(ReadingMaterial(str(tmp_path / "a.brf")), reading)
    assert [line.cells for line in lines] == cells.paragraphs


def test_characters_without_cells_are_left_out_and_named():
    notes = []
    assert load("text:a中", notes).paragraphs == ["⠁"]
    assert "en-1" in notes[-1]
    assert notes[-1].endswith("left out: 中")


@pytest.mark.parametrize(("name", "data", "words"), [
    ("none.brf", None, "none.brf"), ("bad.txt", b"ab\xff", "bad.txt"),
    ("empty.txt", b"\n \n", "nothing"), ("empty.brf", b"", "empty"),
    ("bad.pef", b"<pef/>", ".brf"), ("bad.brf", b"\xff", "ÿ"),
])  # fmt: skip
def test_bad_files(tmp_path, name, data, words):
    if data is not None:
        (tmp_path / name).write_bytes(data)
    with pytest.raises((BrailleError, PageError), match=words):
        load(tmp_path / name)


@pytest.mark.parametrize("text", ["", "  ", "\n\n", "⠀", "中"])
def test_nothing_to_read(text):
    with pytest.raises(BrailleError, match="nothing to read"):
        load(f"text:{text}")


@pytest.mark.skipif(shutil.which("tesseract") is None, reason="needs Tesseract")
def test_pages_of_a_book_come_in_order_and_are_reported(reading, tmp_path):
    path, said = tmp_path / "book.tif", []
    pages = [
        Image.fromarray(print_text(f"The {word}\nis a page of this book").grey)
        for word in ("first", "second", "third")
    ]
    pages[0].save(path, save_all=True, append_images=pages[1:], dpi=(300, 300))
    loaded, last = load(path, said).paragraphs, load(path, pages="3").paragraphs
    assert loaded[-len(last) :] == last
    assert sum("done" in words for words in said) == 2
    lines = list(Braille().lines(ReadingMaterial(str(path)), reading))
    assert [line.text for line in lines][2:4] == ["The second", "is a page of this book"]
