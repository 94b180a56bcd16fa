"""Reading of the text layer of PDF files: words, columns, tables, forms and hidden text."""

import pytest

from smarttouch.pages.document import Document
from smarttouch.reading.reading_material import ReadingMaterial
from smarttouch.reading.recognition import RecognitionOptions, upright_page

from .printed import print_page
from .test_document import one_page, stream

FONT = b"<</Type/Font/Subtype/Type1/BaseFont/%b/Encoding<</Type/Encoding/Differences%b>>>>"
FONTS = {
    b"F": FONT % (b"Helvetica", b"[1/uni2010/uni00AD/uniF0B7]"),
    b"I": FONT % (b"Times-Italic", b"[]"),
}
RESOURCES = b"/Resources<</Font<</F %b/I %b>>" % (FONTS[b"F"], FONTS[b"I"]) + b"%b>>"
PROSE = [
    *("The left column is read", "before the right one is", "begun, line after line."),
    *("Here the page goes on, as", "it does in a newspaper or", "in a book of two columns."),
    *("At last there is a third", "column that some of them", "and it is the end of all."),
]
LEFT, RIGHT = PROSE[:3], PROSE[3:6]
WIDTHS = {"i": 2.22, "t": 2.78, "f": 2.78, "r": 3.33, "m": 8.33, "w": 7.22,
          **dict.fromkeys("cksxy", 5.0)}  # fmt: skip
"""Letter widths of Helvetica at 10 points, in points; letters not listed here are 5.56 wide."""


def put(x, y, text, size=10, font="F", turn=(1, 0, 0, 1), more=""):
    """Return the PDF operators that draw text at (x, y), in points from the bottom left."""
    code = text.encode("latin-1").replace(b"(", b"\\(").replace(b")", b"\\)")
    place = " ".join(map(str, (*turn, x, y)))
    return f"BT /{font} {size} Tf {place} Tm {more} (".encode() + code + b") Tj ET\n"


def marked(x, y, *parts):
    """Return operators of a line. Every second part is raised, or lowered if it begins with _."""
    shown = b"BT %d %d Td " % (x, y)
    for k, part in enumerate(parts):
        rise = 4 - 6 * (part[0] == "_") if k % 2 else 0
        shown += b"/F %d Tf %d Ts (%b) Tj " % (7 if k % 2 else 10, rise, part.strip("_").encode())
    return shown + b"ET\n"


def apart(x, y, text, gap=5):
    """Return PDF operators that place each letter of a line separately, ``gap`` points apart."""
    wide = dict(zip("THEOLDMI ", (6.1, 7.2, 6.7, 7.8, 5.6, 7.2, 8.3, 2.8, 2.8), strict=True))
    shown = b""
    for sign in text:
        shown += put(x, y, sign) if sign != " " else b""
        x += wide[sign] + gap
    return shown


def pdf(path, *content, size=(440, 300), page=b"", objects=b"", **more):
    """Write a PDF of one page and return its path."""
    shown = b"".join(each if isinstance(each, bytes) else put(*each) for each in content)
    path.write_bytes(one_page(shown, size, RESOURCES % objects + page, **more))
    return path


def load(path, **options):
    with Document(path, **options) as document:
        return document.page(0)


def columns(texts, step=14, x=(40, 165, 290), by_rows=False):
    """Yield (x, y, text) for lines in columns of three lines, sorted by column or by row."""
    places = [(x[k // 3], 250 - step * (k % 3), text) for k, text in enumerate(texts)]
    yield from sorted(places, key=lambda place: -place[1]) if by_rows else places


def table(*rows, x=(40, 120, 200), y=200, step=14):
    for k, row in enumerate(rows):
        yield from ((x[n], y - step * k, cell) for n, cell in enumerate(row) if cell)


GRID = [("Name", "Paid out", "Paid in"), ("Rent", "500", ""), ("Salary", "", "700"),
        ("Gas", "Gas", "")]  # fmt: skip
ROWS = ("Name; Paid out; Paid in", "Rent; 500; -", "Salary; -; 700", "Gas; Gas; -")


@pytest.mark.parametrize(("content", "words"), [
    ([put(40, 250, "the first of four fine fish for us", font="I")],
     ["the first of four fine fish for us"]),
    ([put(40, 250, "It was a dark night", more="60 Tz")], ["It was a dark night"]),
    ([put(40, 250, "THE OLD MILL", more="5 Tc")], ["THE OLD MILL"]),
    ([apart(40, 250, "THE OLD MILL")], ["THE OLD MILL"]),
    ([marked(40, 250, "There were 10", "6", " cells, 10", "-3", " of them in H", "_2", "O.")],
     ["There were 10^6 cells, 10^-3 of them in H_2O."]),
    ([marked(40, 250, "as was shown", "1", " on the 3", "rd", " of May by"), (40, 236, "others."),
      marked(40, 200, "", "1", " In a book.")],
     ["as was shown^1 on the 3rd of May by", "others.", "^1 In a book."]),
    ([put(40, 200, "T", 40), put(66, 222, "he mill stood"), put(66, 211, "empty for a"),
      put(66, 200, "year before we"), put(40, 189, "bought it at last.")],
     ["The mill stood", "empty for a", "year before we", "bought it at last."]),
    ([(40, 250, "It was the permis\1"), (40, 236, "sion of the North\2"),
      (40, 222, "South line, an exam-"), (40, 208, "ple of it.")],
     ["It was the permis-", "sion of the North-", "South line, an exam-", "ple of it."]),
    ([(40, 250, "Bring with you:"), (50, 236, "\3 a pencil"), (50, 222, "\3 a cup of tea")],
     ["Bring with you:", "• a pencil", "• a cup of tea"]),
    (columns(PROSE), PROSE),
    (columns(PROSE, by_rows=True), PROSE),
    # The columns share no baselines. The file contains the left column before the right one.
    ([*columns(LEFT), *((165, y - 6, text) for _, y, text in columns(RIGHT))], [*LEFT, *RIGHT]),
    ([*columns(PROSE[:6]), (40, 208, "E = mc"), (140, 208, "(1)"), (40, 194, "is the rule.")],
     [*LEFT, "E = mc", "(1)", "is the rule.", *RIGHT]),
    ([*columns(["apple, 7", "bread, 12", "door, 3", "mill, 9", "oven, 4", "pear, 31"])],
     ["apple, 7", "bread, 12", "door, 3", "mill, 9", "oven, 4", "pear, 31"]),
    ([(40, 240, "What was paid for the house this year"), *table(*GRID)],
     ["What was paid for the house this year", *ROWS]),
    # The left one of two columns contains a table.
    ([*columns(PROSE[:6], x=(40, 220)), *table(*GRID, x=(40, 85, 135)), (220, 208, "So it ends.")],
     [*LEFT, *ROWS, *RIGHT, "So it ends."]),
    ([*table(("Date", "Item", "Sum"), ("1 May", "Rent of", "500"), ("", "the mill", ""), step=12),
      *table(("2 May", "Gas", "7")[:], y=158)],
     ["Date; Item; Sum", "1 May; Rent of; 500", "-; the mill; -", "2 May; Gas; 7"]),
    (table(("Town", "1990", "2000"), ("Mill", "12", "15"), ("Bridge", "", "7"), x=(40, 72, 99)),
     ["Town; 1990; 2000", "Mill; 12; 15", "Bridge; -; 7"]),
    ([(40, 250, "Name:"), (40, 236, "Town:"), (120, 250, "Ada"), (120, 236, "London")],
     ["Name:; Ada", "Town:; London"]),
    ([put(40, 250, "These words are level,"), put(40, 236, "and so are these."),
      put(30, 100, "arXiv:2611.01234", turn=(0, 1, -1, 0)),
      put(60, 220, "DRAFT", 30, turn=(0.7, 0.7, -0.7, 0.7))],
     ["These words are level,", "and so are these."]),
    ([(40, 250, "These are on the page."), (-90, 236, "beside the page"), (40, -20, "below it")],
     ["These are on the page."]),
    ([(50, 236, "a pencil"), (50, 222, "a cup"), (40, 236, "1."), (40, 222, "2.")],
     ["1. a pencil", "2. a cup"]),
], ids=["italics", "condensed", "spaced", "letters", "powers", "footnotes", "initial", "hyphens",
        "bullets", "columns", "columns by rows", "columns offset", "equation", "index",
        "table", "table in a column", "cells of lines", "narrow table",
        "labels", "turned", "outside", "marks of items"])  # fmt: skip
def test_text_is_read_as_it_is_seen(tmp_path, content, words):
    assert load(pdf(tmp_path / "a.pdf", *content)).words == tuple(words)


@pytest.mark.parametrize(("width", "texts"), [
    (190, ["stood bread window considerations", "window night the a house house",
           "considerations stood notwithstanding", "extraordinarily night garden morning a",
           "under extraordinarily extraordinarily"]),
    (110, ["window night the a", "considerations of", "extraordinarily a", "considerations it",
           "some neighbourhood"]),
])  # fmt: skip
def test_justified_prose_is_no_table(tmp_path, width, texts):
    content = []
    for k, text in enumerate(texts):
        words = text.split()
        lengths = [sum(WIDTHS.get(sign, 5.56) for sign in word) for word in words]
        x, gap = 40.0, (width - sum(lengths)) / (len(words) - 1)
        for word, length in zip(words, lengths, strict=True):
            content.append(put(x, 250 - 14 * k, word))
            x += length + gap
    assert load(pdf(tmp_path / "a.pdf", *content)).words == tuple(texts)


@pytest.mark.parametrize("page", [
    b"", b"/CropBox[-20 -20 900 900]", b"/CropBox[390 290 30 100]", b"/CropBox[30 210 250 500]",
    b"/Rotate 90/CropBox[20 40 300 280]", b"/Rotate 90",
])  # fmt: skip
def test_lines_lie_on_their_print(tmp_path, page):
    is_turned = b"Rotate 90/" in page
    turn = (0, 1, -1, 0) if is_turned else (1, 0, 0, 1)
    step = (14, 0) if is_turned else (0, -14)
    # Up to 100 rotated characters are taken for a stamp, so the rotated page needs more text.
    lines = PROSE if page == b"/Rotate 90" else LEFT
    content = [put(60 + step[0] * k, 250 - 10 * abs(step[0]) + step[1] * k, text, turn=turn)
               for k, text in enumerate(lines)]  # fmt: skip
    found = load(pdf(tmp_path / "a.pdf", *content, page=page))
    assert found.words == tuple(lines)
    ink = found.grey < 128
    for line in found.lines:
        top, bottom, left, right = (
            round(side / found.mm_per_pixel)
            for side in (line.top_mm, line.bottom_mm, line.left_mm, line.right_mm)
        )
        assert ink[top:bottom, left:right].any()
        ink[top : bottom + 1, left - 1 : right + 2] = False
    assert not ink.any()


def test_the_text_is_that_of_the_layer(tmp_path):
    path = pdf(tmp_path / "a.pdf", *columns(PROSE))
    source = ReadingMaterial(str(path), RecognitionOptions(keep_headers=True))
    (prepared,) = source.prepared()
    assert source.paragraphs(str) == [" ".join(PROSE)]
    assert prepared.cleaned.min() < 60


def test_what_is_filled_into_a_form_is_read_beside_its_label(tmp_path):
    values = ["Ada Lovelace", "10 December"]
    objects = []
    for k, value in enumerate(values):
        objects += [
            b"<</Type/Annot/Subtype/Widget/FT/Tx/T(f%d)/V(%b)/F 4/P 3 0 R/Rect[140 %d 300 %d]"
            b"/AP<</N %d 0 R>>>>" % (k, value.encode(), 246 - 20 * k, 262 - 20 * k, 6 + 2 * k),
            stream(put(2, 4, value), b"/Type/XObject/Subtype/Form/BBox[0 0 160 16]"
                   + RESOURCES % b""),
        ]  # fmt: skip
    path = pdf(
        tmp_path / "a.pdf", (40, 250, "Name:"), (40, 230, "Date of birth:"),
        page=b"/Annots[5 0 R 7 0 R]", catalog=b"/AcroForm<</Fields[5 0 R 7 0 R]>>", more=objects,
    )  # fmt: skip
    page = load(path, dpi=72)
    assert page.words == ("Name:; Ada Lovelace", "Date of birth:; 10 December")
    assert page.grey[38:54, 140:190].min() < 128


def picture(lines):
    """Draw lines as a picture in two strips; return its size, PDF operators and PDF objects."""
    grey = print_page(lines, size_pt=10, dpi=150).page.grey
    height, width = grey.shape
    half = height // 2
    objects = [
        stream(part.tobytes(), b"/Type/XObject/Subtype/Image/Width %d/Height %d"
               b"/ColorSpace/DeviceGray/BitsPerComponent 8" % part.shape[::-1])
        for part in (grey[:half], grey[half:])
    ]  # fmt: skip
    shown = b"q %d 0 0 %d 0 %d cm /P Do Q q %d 0 0 %d 0 0 cm /Q Do Q\n" % (
        width, half, height - half, width, height - half,
    )  # fmt: skip
    return (width, height), shown, objects


STAMP = "Downloaded from https://library.example by a reader of it"


@pytest.mark.parametrize("stamp", [b"", put(40, 8, STAMP), put(20, 9, STAMP, turn=(0, 1, -1, 0))],
                         ids=["none", "level", "turned"])  # fmt: skip
def test_a_scan_in_strips_is_recognized(tmp_path, stamp):
    size, shown, objects = picture(PROSE)
    path = pdf(tmp_path / "a.pdf", shown, stamp, size=size, more=objects,
               objects=b"/XObject<</P 5 0 R/Q 6 0 R>>")  # fmt: skip
    page = load(path, dpi=72)
    assert not page.lines
    assert page.grey.shape == size[::-1]


def test_a_hidden_text_of_a_scan_is_read(tmp_path):
    size, shown, objects = picture(PROSE[:1])
    hidden = put(85, size[1] - 115, PROSE[0], 20, more="3 Tr")
    path = pdf(tmp_path / "a.pdf", shown, hidden, size=size, more=objects,
               objects=b"/XObject<</P 5 0 R/Q 6 0 R>>")  # fmt: skip
    assert load(path).words == (PROSE[0],)


def test_text_that_nobody_sees_is_not_read(tmp_path):
    hidden = b"1 g " + put(40, 200, "white words here") + b"0 g "
    grey = b"0.9 g " + put(130, 200, "but pale ones are, -") + b"0 g "
    page = load(pdf(tmp_path / "a.pdf", (40, 250, "These words are seen,"), hidden, grey))
    assert page.words == ("These words are seen,", "but pale ones are, -")
    assert page.notes == ("text that is not visible is left out (characters: 14)",)


@pytest.mark.parametrize("turned", [False, True])
def test_print_that_is_not_read_is_named(tmp_path, turned):
    prose = [(40, 780 - 14 * k, PROSE[k % 9] + " " + PROSE[(k + 1) % 9]) for k in range(30)]
    if turned:
        content, objects = [put(20, 100, "a stamp", turn=(0, 1, -1, 0))], {}
    else:
        _, shown, streams = picture(["these words are in a", "picture of the page"])
        place = b"q 0.5 0 0 0.5 40 20 cm "
        content, objects = [place + shown + b" Q "], {"more": streams}
    page = load(pdf(tmp_path / "a.pdf", *prose, *content, size=(500, 820), **objects,
                    objects=b"/XObject<</P 5 0 R/Q 6 0 R>>"))  # fmt: skip
    assert len(page.words) == 30
    notes = []
    upright_page(7, page, RecognitionOptions(), notes.append)
    assert sum(note.startswith("page 7: ") and page.notes[0] in note for note in notes) == 1


def test_unknown_codes_are_not_believed(tmp_path):
    fonts = FONT % (b"Helvetica", b"[97/g1/g2/g3/g4/g5/g6/g7]")
    page = load(pdf(tmp_path / "a.pdf", *[put(x, y, "abc defg abc") for x, y, _ in columns(PROSE)],
                    objects=b"/Font<</F %b>>" % fonts))  # fmt: skip
    assert page.lines == ()
    assert len(page.notes) == 1
    assert load(pdf(tmp_path / "b.pdf")).notes == ()
