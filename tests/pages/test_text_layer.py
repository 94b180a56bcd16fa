"""The text that a PDF brings is read as it stands: columns, rows of tables, and no invalid text."""

import string

import pytest

from smarttouch.pages.document import open_document
from smarttouch.pages.page_image import Page
from smarttouch.pages.text_layer import PicturedPage
from smarttouch.reading.material import ReadingMaterial, recognized_text
from smarttouch.reading.recognition import RecognitionOptions, upright_page

from .test_document import one_page, stream

FONT = b"/Resources<</Font<</F<</Type/Font/Subtype/Type1/BaseFont/Helvetica>>>>>>"
LEFT = ["The left column is read", "before the right one is", "begun, line after line."]
RIGHT = ["Here the page goes on, as", "it does in a newspaper or", "in a book of two columns."]


def pdf(path, *placed, size=(400, 300), **more):
    """Write a PDF with words at places in points from the bottom left; return its path."""
    shown = b"".join(b"BT /F 10 Tf %.2f %d Td (%b) Tj ET\n" % (x, y, text.encode("latin-1"))
                     for x, y, text in placed)  # fmt: skip
    path.write_bytes(one_page(shown, size, FONT + more.pop("page", b""), **more))
    return path


def layer(path):
    with open_document(path) as document:
        return document.page(0)


def columns():
    for k, (left, right) in enumerate(zip(LEFT, RIGHT, strict=True)):
        yield 40, 250 - 14 * k, left
        yield 220, 250 - 14 * k, right


def test_columns_are_finished_before_they_are_left(tmp_path):
    page = layer(pdf(tmp_path / "a.pdf", *columns()))
    assert page.words == (*LEFT, *RIGHT)
    first = page.lines[0]
    assert first.left_mm == pytest.approx(40 * 25.4 / 72, abs=0.5)
    assert first.bottom_mm > (300 - 250) * 25.4 / 72 > first.top_mm


def test_a_full_line_does_not_reach_into_the_next_column(tmp_path):
    full = (40, 208, "its last line is wide and all but fills it up.")
    page = layer(pdf(tmp_path / "a.pdf", *columns(), full, (220, 208, "is apart from it.")))
    assert page.words == (*LEFT, full[2], *RIGHT, "is apart from it.")
    gap_mm = page.lines[-1].left_mm - page.lines[3].right_mm
    assert 0.4 * 10 < gap_mm * 72 / 25.4 < 1.1 * 10


def test_rows_of_a_table_are_whole(tmp_path):
    rows = [("Name", "Price"), ("Apple", "3"), ("Pear tree", "12")]
    placed = [(40 + 120 * k, 200 - 14 * row, cell)
              for row, cells in enumerate(rows) for k, cell in enumerate(cells)]  # fmt: skip
    title = (40, 240, "What each of the fruits in the garden costs this year")
    page = layer(pdf(tmp_path / "a.pdf", title, *placed))
    assert page.words == (title[2], "Name; Price", "Apple; 3", "Pear tree; 12")


def test_columns_of_figures_part_where_they_nearly_touch(tmp_path):
    rows = [("Town", "1990", "1997"), ("Great Apple", "1,204", "12,345"), ("Pear", "9", "7"),
            ("Long Plum", "88", "210")]  # fmt: skip
    # A figure is as wide as a space and a comma: 5.56 and 2.78 of 10 points.
    wide = [5.56 * (len(each) - each.count(",")) + 2.78 * each.count(",")
            for row in rows for each in row]  # fmt: skip
    placed = [(95 + 34 * k - wide[3 * row + k] if k else 40, 200 - 14 * row, cell)
              for row, cells in enumerate(rows) for k, cell in enumerate(cells)]  # fmt: skip
    prose = [
        (40, 250, "In 1990 and 1997 there were 12"),
        (40, 236, "in 1204 houses, 7 of them new."),
    ]
    listed = [(40, 130 - 14 * k, f"Chapter {k + 1}") for k in range(3)]
    page = layer(pdf(tmp_path / "a.pdf", *prose, *placed, *listed))
    assert page.words == (
        *(text for *_, text in prose), *("; ".join(row) for row in rows),
        *(text for *_, text in listed),
    )  # fmt: skip


def test_the_text_is_that_of_the_layer(tmp_path):
    path = pdf(tmp_path / "a.pdf", *columns())
    source = ReadingMaterial(str(path), RecognitionOptions(keep_headers=True))
    (prepared,) = source.prepared()
    assert recognized_text(prepared, source.options, source.note) == " ".join((*LEFT, *RIGHT))
    assert prepared.cleaned.min() < 60


def test_wrong_codes_are_not_believed(tmp_path):
    letters = string.ascii_lowercase
    shifted = str.maketrans(letters, letters[3:] + letters[:3])
    page = layer(pdf(tmp_path / "a.pdf", *((x, y, text.translate(shifted))
                                           for x, y, text in columns())))  # fmt: skip
    assert isinstance(page, PicturedPage)
    assert type(layer(pdf(tmp_path / "b.pdf"))) is Page
    notes = []
    upright_page(7, page, RecognitionOptions(), notes.append)
    assert sum(note.startswith("page 7:") and page.reason in note for note in notes) == 1


def test_a_scan_with_a_stamp_is_recognized(tmp_path):
    picture = stream(b"\xff" * 100, b"/Type/XObject/Subtype/Image/Width 10/Height 10"
                     b"/ColorSpace/DeviceGray/BitsPerComponent 8")  # fmt: skip
    font = FONT[: -len(b">>")] + b"/XObject<</I 5 0 R>>>>"
    shown = b"q 380 0 0 280 10 10 cm /I Do Q BT /F 10 Tf 40 20 Td (page 5) Tj ET"
    (tmp_path / "a.pdf").write_bytes(one_page(shown, (400, 300), font, more=[picture]))
    assert isinstance(layer(tmp_path / "a.pdf"), PicturedPage)
