"""Paragraphs from printed lines: joined words, rows of tables, and removed running heads."""

import re

import pytest

from smarttouch.reading.paragraphs import PrintedLine, paragraphs, without_heads

CHARACTER_MM, STEP_MM, TOP_MM = 1.5, 4.0, 20.0


def page(text, number=1, left_mm=20.0):
    """Return the lines of a monospaced page; # marks large print, and 3 spaces separate cells."""
    lines = []
    for row, line in enumerate(text.split("\n")):
        cells = list(re.finditer(r"\S+(?: {1,2}\S+)*", line))
        for cell, found in enumerate(cells, 1):
            words = found[0].removeprefix("# ")
            left = left_mm + CHARACTER_MM * found.start()
            lines.append(PrintedLine(
                words, number, left, left + CHARACTER_MM * len(words), TOP_MM + STEP_MM * row,
                3.0 if words != found[0] else 2.0, cell if len(cells) > 1 else 0,
            ))  # fmt: skip
    return lines


@pytest.mark.parametrize(("text", "found"), [
    # A paragraph begins at a heading, at an indent, after a gap, and after a short line.
    ("# Of pages\nThe first words are here\nand more of them come.\n  Another one begins so\n"
     "and goes on.\nThis one follows an end.\n\nAfter a gap",
     ["Of pages", "The first words are here and more of them come.",
      "Another one begins so and goes on.", "This one follows an end.", "After a gap"]),
    # List items, with their continuation lines.
    ("Bring what you need for it:\n- a pencil and a piece of\n  paper\n- some tea\n\nThen:\n"
     "1. Open the gate of the mill\nand wait.\n2. Go.\n• nothing\n◦ at all",
     ["Bring what you need for it:", "- a pencil and a piece of paper", "- some tea", "Then:",
      "1. Open the gate of the mill and wait.", "2. Go.", "• nothing", "◦ at all"]),
    # Verse, an address and unmarked lists keep their lines.
    ("The wheel goes round the day\nand sings to all;\nthe water gives it its song\nand its call.",
     ["The wheel goes round the day", "and sings to all;", "the water gives it its song",
      "and its call."]),
    ("Shall I compare thee to a summer\nThou art more lovely and more\n"
     "Rough winds do shake the buds\nAnd summer is too short a date",
     ["Shall I compare thee to a summer", "Thou art more lovely and more",
      "Rough winds do shake the buds", "And summer is too short a date"]),
    ("He went to the old mill by the river and\nto see the wheel that turned all day\n"
     "in it, and the water that ran below\nto the sea, and then he went home with us.",
     ["He went to the old mill by the river and", "to see the wheel that turned all day",
      "in it, and the water that ran below", "to the sea, and then he went home with us."]),
    ("Mrs Ada Miller\n4 Mill Lane\nLondon\n\nDear Mrs Miller, thank you for\nthe letter that came.",
     ["Mrs Ada Miller", "4 Mill Lane", "London",
      "Dear Mrs Miller, thank you for the letter that came."]),
    ("You need these for a loaf of bread:\n\nflour for two loaves\nsugar\nsalt\nmilk",
     ["You need these for a loaf of bread:", "flour for two loaves", "sugar", "salt", "milk"]),
    # Slightly short or slightly indented lines are prose.
    ("He went to the old mill by the river and saw the wheel going\n"
     "so well that he told all his friends of it when he was\n"
     "at home, and then they went to the mill and saw it too.",
     ["He went to the old mill by the river and saw the wheel going so well that he told all "
      "his friends of it when he was at home, and then they went to the mill and saw it too."]),
    ("One is a line of the text here and\n so is this one, which goes on and on.\n"
     " And this one has the same place so,\n   Another paragraph begins in here\nand goes on.",
     ["One is a line of the text here and so is this one, which goes on and on. And this one has "
      "the same place so,", "Another paragraph begins in here and goes on."]),
    # Tables of contents lose their dot leaders; forms keep the blanks to fill in.
    ("Preface . . . . . . . . . v\nThe river and the dam that\nholds it ................ 12\n"
     "Wait ... and see ........ 9\nName: ____________________\nAge .......................",
     ["Preface v", "The river and the dam that holds it 12", "Wait ... and see 9",
      "Name: ____________________", "Age ......................."]),
    # Bibliography entries with hanging indents.
    ("Miller, Ada: On the wheels of\n    mills, and on the water\n    below.\n"
     "Other, Ben: On bread and what\n    it is made of, with an\n    index.",
     ["Miller, Ada: On the wheels of mills, and on the water below.",
      "Other, Ben: On bread and what it is made of, with an index."]),
    ("[1] A. Miller, The old mill by the river\nin it, 1899.\n[2] B. Other, On rivers.",
     ["[1] A. Miller, The old mill by the river in it, 1899.", "[2] B. Other, On rivers."]),
    # An empty table cell becomes a hyphen.
    ("Stop   Mon   Sat   Sun\nMill   7:05   8:05\nWell                8:31\n"
     "Hall   7:20         9:20",
     ["Stop; Mon; Sat; Sun", "Mill; 7:05; 8:05; -", "Well; -; -; 8:31", "Hall; 7:20; -; 9:20"]),
])  # fmt: skip
def test_where_paragraphs_begin(text, found):
    assert paragraphs(page(text)) == found


@pytest.mark.parametrize(("text", "found"), [
    ("a divi-\nded word", "a divided word"), ("a divi\u00ad\nded word", "a divided word"),
    ("a divi\u2010\nded word", "a divided word"), ("a divi\x02\nded word", "a divided word"),
    ("the North-\nSouth line", "the North-South line"), ("pages 12\u2010\n14", "pages 12-14"),
    ("one-half, or one-\nhalf more", "one-half, or one-half more"), ("CON-\nTENTS", "CONTENTS"),
    ("it is so -\nor not", "it is so - or not"), ("pre-\nand postwar", "pre- and postwar"),
    ("a well-\nknown one", "a well-known one"),
    ("at http://a.b/c-\nd/e now", "at http://a.b/c-d/e now"),
])  # fmt: skip
def test_hyphens_at_the_ends_of_lines(text, found):
    assert paragraphs(page(text)) == [found]
    first, second = text.split("\n")
    assert paragraphs(page(first, 1) + page(second, 2)) == [found]


def test_a_paragraph_continues_in_the_next_column_and_behind_a_footnote():
    left, right = page("one and two\nand three and"), page("four and five\nand six and", 1, 120)
    # A footnote has smaller print.
    foot = [PrintedLine("* A note.", 1, 120, 140, 60, 1.2)]
    after = page("seven.\nAnother one is here", 2)
    assert paragraphs(left + right + foot + after) == [
        "one and two and three and four and five and six and seven.", "* A note.",
        "Another one is here",
    ]  # fmt: skip


BODY = ("It was a dark night", "They had come by road", "At last the wheel turned")


def book(*pages):
    return [line for number, text in enumerate(pages, 5) for line in page(text, number)]


@pytest.mark.parametrize(("head", "foot", "is_dropped"), [
    (("THE OLD MILL",) * 3, ("5", "6", "7"), True),
    (("9 The Mill", "A Tale 10", "11 The Mill"), ("",) * 3, None),
    (("Journal, 12 May", "Journal, 12 May", "Journal, 12 May"), ("- 7 -", "- 8 -", "- 9 -"), True),
    (("", "", ""), ("Page 5 of 7", "Page 6 of 7", "Page 7 of 7"), True),
    (("She was ill", "12 Mill Lane", "Chapter 12"), ("Pay: 1250", "1984", "vi"), False),
    (("1 Introduction", "2 Methods", "3 Results"), ("12", "15", "31"), False),
])  # fmt: skip
def test_running_heads_and_numbers_go_where_they_repeat_and_are_named(head, foot, is_dropped):
    lines = book(*(
        f"{top}\n\n{body}\nthen more\nand so on.\n\n{bottom}"
        for top, body, bottom in zip(head, BODY, foot, strict=True)
    ))  # fmt: skip
    notes = []
    texts = [line.text for line in without_heads(lines, notes.append)]
    kept = [text for text in (*head, *foot) if text in texts]
    if is_dropped is None:
        assert kept == [head[1]]
    else:
        assert kept == ([] if is_dropped else [text for text in (*head, *foot) if text])
    assert len(notes) == (is_dropped is not False)
    assert all(" pages, 5 to 7" in note for note in notes)


@pytest.mark.parametrize("lines", [
    book("THE OLD MILL\n\nIt was a dark night\n\n12"), book("Thank you", "Thank you"),
    book(*["Dear Ada,\n\nplease come\nat ten.\nYours\nBen"] * 2),
])  # fmt: skip
def test_one_page_copies_and_slides_of_one_line_stay_whole(lines):
    assert without_heads(lines, pytest.fail) == lines


def test_forms_lose_their_numbers_alone():
    lines = book(*(f"Mill\nDay\nName\nWheel\nWater\n\n{number}" for number in (5, 6, 7)))
    kept = [line.text for line in without_heads(lines, lambda _: None)]
    assert kept == ["Mill", "Day", "Name", "Wheel", "Water"] * 3
