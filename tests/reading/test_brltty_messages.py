"""BRLTTY's messages, however they are cut into pieces."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.reading.brltty_connection import (
    LONGEST_LINE,
    MOST_CELLS,
    BrlttyMessages,
    DisplayContent,
)

CELLS = st.text(st.characters(min_codepoint=0x2800, max_codepoint=0x28FF), min_size=1, max_size=40)


def said(cells, text=""):
    """Return what BRLTTY sends of cells and their text."""
    dots = [
        "".join(str(dot + 1) for dot in range(8) if ord(cell) >> dot & 1) or " " for cell in cells
    ]
    quoted = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'Visual "{quoted}"\r\nBraille "{"|".join(dots)}"\r\n'.encode()


@given(st.lists(st.tuples(CELLS, st.text('ab "\\ä€', max_size=9)), min_size=1), st.data())
def test_lines_are_found_in_any_pieces(shows, data):
    stream = b"".join(said(*each) for each in shows)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    messages = BrlttyMessages()
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        messages.feed(stream[begin:end])
    cells, text = shows[-1]
    assert replace(messages.shown, time_ns=0) == DisplayContent(cells, text.rstrip(), len(shows))


@given(st.lists(st.binary(max_size=80), max_size=20))
def test_anything_may_come(pieces):
    messages = BrlttyMessages()
    for each in pieces:
        messages.feed(each)
    messages.feed(b"\n" + said("⠓⠊"))
    assert messages.shown.cells == "⠓⠊"


@pytest.mark.parametrize(
    "line",
    [b'Braille "19"', b'Braille "21"', b'Braille "a"', b"Braille", b"cells 20",
     b'Braille "' + b"|" * MOST_CELLS + b'"', b"x" * (LONGEST_LINE + 1)],
)  # fmt: skip
def test_what_is_no_message_is_dropped(line):
    messages = BrlttyMessages()
    messages.feed(line)
    messages.feed(b"\r\n")
    assert messages.shown == DisplayContent()


@pytest.mark.parametrize(("before", "now", "first"), [
    ("⠓⠊⠀⠀", "⠓⠊⠀⠀", None),
    ("⠓⠊⠀⠀", "⠓⠊⠞⣀", 2),  # typed: the cursor stands behind it
    ("⠓⠊⠞⣀", "⠓⠊⣀⠀", 2),  # deleted: the cursor stands there
    ("⠓⠊⣀⠀", "⠓⣊⠀⠀", None),  # only the cursor moved
    ("⠓⠊⠞⠀", "⠓⠊⠙⠀", 0),  # another line, as nobody types
    ("", "⠓⠊", 0),
    ("⠓⠊⠞", "⠓⠊", 0),
])  # fmt: skip
def test_the_first_new_cell(before, now, first):
    assert DisplayContent(now).first_new(DisplayContent(before)) == first
