"""Typeset pages are read in order, and photographs of print as the flat page."""

import shutil

import numpy as np
import pytest

from smarttouch.pages.page_image import Page
from smarttouch.pages.prepared_page import prepare_page
from smarttouch.reading.legibility import character_error_rate
from smarttouch.reading.material import recognized_text
from smarttouch.reading.recognition import RecognitionOptions, upright_page

from . import typeset
from .photographed import photographs

needs_tesseract = pytest.mark.skipif(
    shutil.which("tesseract") is None, reason="needs Tesseract: apt install tesseract-ocr"
)


@pytest.mark.parametrize(
    "layout", [typeset.box, typeset.caption, typeset.table_beside, typeset.leftward]
)
def test_pieces_of_a_layout_are_in_order(layout):
    sheet = typeset.typeset(layout, 0)
    page = Page(sheet.grey, typeset.MM_PER_PIXEL)
    prepared = prepare_page(page, straightened=False, leftward=layout is typeset.leftward)
    order = typeset.prepared_order(sheet, prepared)
    found = order[order >= 0]
    # Narrow cells may be found as one; a word of two letters alone may be lost.
    assert (np.diff(found) >= 0).all()
    assert len(order) - len(found) <= 1


@needs_tesseract
@pytest.mark.parametrize("layout", [typeset.cast, typeset.index])
def test_tesseracts_blocks_tell_rows_from_columns(monkeypatch, layout):
    sheet = typeset.typeset(layout, 0)
    page = Page(sheet.grey, typeset.MM_PER_PIXEL)
    order = typeset.prepared_order(sheet, prepare_page(page))
    assert order.tolist() == sorted(order)
    assert order.min() == 0
    # Without Tesseract every line is found, in another order.
    monkeypatch.setenv("PATH", "")
    alone = typeset.prepared_order(sheet, prepare_page(page))
    assert sorted(alone) == order.tolist() != alone.tolist()


def test_an_initial_stands_before_its_first_line():
    sheet = typeset.typeset(typeset.drop_caps, 0)
    page = Page(sheet.grey, typeset.MM_PER_PIXEL)
    prepared = prepare_page(page, straightened=False)
    boxes = [line.initial_mm for line in prepared.lines]
    firsts = [k for k, piece in enumerate(sheet.pieces) if piece.text[0] in "TB" and not k % 24]
    assert [k for k, box in enumerate(boxes) if box] == firsts
    for k in firsts:
        left, top, right, bottom = np.array(boxes[k]) / typeset.MM_PER_PIXEL
        piece = sheet.pieces[k]
        assert left < right < piece.left
        assert piece.y - piece.size < top < piece.y
        assert bottom == pytest.approx(sheet.pieces[k + 2].y, abs=3)
        # The letter of the strip is dark, and about as high as a capital.
        strip = prepared.strip(k, 40)
        first = np.flatnonzero((strip < 128).any(axis=0))[0]
        high = np.flatnonzero((strip[:, first : first + 12] < 128).any(axis=1))
        assert 22 < np.ptp(high) < 34


@needs_tesseract
def test_a_photograph_is_read_as_the_flat_page():
    _, flat, photo = next(photographs(1))
    options = RecognitionOptions()
    text = recognized_text(upright_page(1, photo.page, options, str), options, str)
    truth = " ".join(line.text for line in flat.lines)
    assert character_error_rate(truth, text.replace("\n", " ")) <= 0.02
