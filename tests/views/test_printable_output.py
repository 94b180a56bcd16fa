"""Tests that no control character from names or messages reaches a terminal."""

import io
import sys
import unicodedata

from smarttouch.views import printable_output
from smarttouch.views.printable_output import PlainStream, printable

OBEYED = (
    *range(0x20), *range(0x7F, 0xA0), 0x61C, 0x200E, 0x200F, *range(0x2028, 0x202F),
    *range(0x2066, 0x206A), 0xFEFF, *range(0xE0000, 0xE0080), 0xD800, 0xDFFF,
)  # fmt: skip
EVIL = "a\x1b]0;owned\x07\x1b[2J\x9b31m\u202eb\x7f\r\x08"


class Screen(io.StringIO):
    """Text stream in memory that claims to be a terminal."""

    def isatty(self):
        return True


def test_all_that_a_terminal_obeys_has_a_visible_stand_in():
    for code in OBEYED:
        shown = printable(f"a{chr(code)}b")
        assert len(shown) == 3
        if chr(code) in "\n\t":
            assert shown[1] == chr(code)
        else:
            assert unicodedata.category(shown[1]) == "So"
    assert printable("\x1b\x07\x7f\x9b") == "␛␇␡�"


def test_words_stay_as_they_are():
    # Some writing systems need joiners, combining marks or characters beyond the basic plane.
    for text in ("naïve Ω", "می‌خواهم", "क्‍ष", "ਸ਼", "👩‍🔬", "⠓⠑⠇⠇⠕", "a\tb\nc", "−µ×"):
        assert printable(text) == text


def test_plain_output():
    screen = Screen()
    output = PlainStream(screen, "standard output")
    print(EVIL, file=output, flush=True)
    assert screen.getvalue() == printable(EVIL) + "\n"
    assert not output.isatty()
    assert output.encoding == screen.encoding
    # These attributes would let control characters bypass the filter.
    assert not hasattr(output, "buffer")
    assert not hasattr(output, "writelines")


def test_a_console_draws_and_shows_nothing_else(monkeypatch):
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    screen = Screen()
    monkeypatch.setattr(sys, "stdout", PlainStream(screen, "standard output"))
    console = printable_output.console(highlight=False)
    table = Table(EVIL, title=EVIL)
    table.add_row("[red]:smile:[/nothing]", Text(EVIL, "bold"))
    for each in (EVIL, table, Panel(EVIL, title=EVIL), Text(EVIL, "red")):
        console.print(each)
    with console.status(EVIL):
        pass
    written = screen.getvalue()
    assert "\x1b[31m" in written
    for evil in ("\x1b]0;", "\x1b[2J", "\x9b", "\u202e", "\x07", "\x7f", "\x08"):
        assert evil not in written
    assert "[red]:smile:[/nothing]" in written


def test_a_sentence_at_the_left_leaves_room_beside_it(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    printable_output.print_table(
        [("many words " * 9, "beside", "them")], ["effect", "paper", "fingers"]
    )
    printed = capsys.readouterr().out
    assert all(each in printed for each in ("paper", "fingers", "beside", "them"))
