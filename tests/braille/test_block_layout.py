"""Headings, lists, tables and page numbers stand where Braille Formats puts them."""

from smarttouch.base.errors import BrailleError
from smarttouch.braille.block_layout import lay_out_blocks, shaped_text
from smarttouch.braille.cell_pages import write_cells
from smarttouch.braille.cells import BLANK, format_brf, parse_pef
from smarttouch.braille.code_tables import open_table
from smarttouch.pages.structured_text import Block, BlockKind, Run, StructuredText

from ..raising import raises


def document(*blocks):
    """Return a document of kinds, levels and texts."""
    made = tuple(Block(BlockKind(kind), level, (Run(text),)) for kind, level, text in blocks)
    return StructuredText(made, "A title", "A. Writer", "en")


def printed(text, columns=20, rows=20):
    """Return the lines of each page in ASCII Braille."""
    pages = lay_out_blocks(shaped_text(text, open_table("en-1")), columns, rows)
    return [sheet.split("\r\n")[:-1] for sheet in format_brf(pages).decode().split("\f")]


def test_each_block_has_its_shape():
    (page,) = printed(document(
        ("heading", 1, "tea"), ("paragraph", 0, "words that run over a line"),
        ("heading", 2, "cups"), ("item", 0, "an item that is longer"), ("item", 1, "inner"),
        ("row", 0, "a; b"), ("heading", 3, "rest"), ("paragraph", 0, "end"),
    ))  # fmt: skip
    assert page == [
        "        TEA", "", "  WORDS THAT RUN", "OVER A LINE", "", "    CUPS", "",
        "AN ITEM THAT IS", "    LONGER", "  INNER", "", "A2 B", "", "      REST", "  END",
        "", "", "", "", "                  #A",
    ]  # fmt: skip


def test_a_heading_is_never_the_last_of_a_page_and_pages_are_numbered():
    pages = printed(document(
        *(("paragraph", 0, f"word{k}") for k in range(5)), ("heading", 2, "next"),
        ("paragraph", 0, "more"),
    ), rows=8)  # fmt: skip
    assert [page[0].strip() for page in pages] == ["WORD#J", "NEXT"]
    assert [page[-1].strip() for page in pages] == ["#A", "#B"]
    assert {len(page) for page in pages} == {8}


def test_a_long_heading_is_centered_line_by_line():
    (page,) = printed(document(("heading", 1, "one two three four five")))
    for line in page[:2]:
        left = len(line) - len(line.lstrip())
        assert left >= 3
        assert abs(20 - len(line) - left) <= 1


def test_a_pef_names_its_document(tmp_path):
    text = document(("paragraph", 0, "word"))
    pages = lay_out_blocks(shaped_text(text, open_table("en-1")))
    write_cells(tmp_path / "a.pef", pages, shaped_text(text, open_table("en-1")))
    data = (tmp_path / "a.pef").read_text()
    for name, value in (("title", "A title"), ("creator", "A. Writer"), ("language", "en")):
        assert f"<dc:{name}>{value}</dc:{name}>" in data
    assert [[line.strip(BLANK) for line in page] for page in parse_pef(data.encode())] == [
        [line.strip(BLANK) for line in page] for page in pages
    ]


def test_too_small_a_page_for_blocks():
    shaped = shaped_text(document(("item", 3, "word")), open_table("en-1"))
    with raises(BrailleError, about="page"):
        lay_out_blocks(shaped, columns=9)


def test_pages_of_print_are_marked_and_go_on_with_letters():
    go_on = Block(BlockKind.PARAGRAPH, 0, (Run("and more words"),), continued=True)
    text = document(
        ("page", 0, "iv"), ("paragraph", 0, "one"), ("page", 0, "5"), ("paragraph", 0, "two"),
    )  # fmt: skip
    rest = document(
        ("page", 0, "6"), ("page", 0, "7"), ("heading", 2, "next"), ("paragraph", 0, "word " * 12),
    ).blocks  # fmt: skip
    pages = printed(StructuredText((*text.blocks, *rest[:2], go_on, *rest[2:])), rows=9)
    assert pages == [
        ["                  IV", "  ONE", "------------------#E", "  TWO", "---------------#F-#G",
         "AND MORE WORDS", "", "", "                  #A"],
        ["              A#F-#G", "    NEXT", "  WORD WORD WORD", *["WORD WORD WORD WORD"] * 2,
         "WORD", "", "", "                  #B"],
    ]  # fmt: skip
