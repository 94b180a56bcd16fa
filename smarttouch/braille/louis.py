"""Translation by liblouis, if it is installed."""

import ctypes
import ctypes.util
import itertools
import re
import threading
import unicodedata
from collections.abc import Iterator, Sequence
from functools import cache

from smarttouch.base.errors import BrailleError
from smarttouch.braille.cells import BLANK, pattern

INSTALL = "apt install liblouis20 liblouis-data"
JOINERS = "\u200c\u200d"
"""Invisible joiners, which have cells in some codes."""
_LIBRARIES = ("liblouis.so.20", "liblouis.so", "liblouis.20.dylib", "liblouis.dylib")

_DOTS = 0x8000  # code of a blank cell, for cells that liblouis decodes (LOU_DOTS in liblouis.h)
_DOTS_IO, _UNICODE_CELLS, _NO_UNDEFINED = 4, 64, 128  # values of ``translationModes`` in liblouis.h
_LOG_OFF = 60000
_LONGEST_NAME = 200
"""Longest name of a table, bytes. Old versions of liblouis do not check the length of names."""
_CAPACITIES = (8, 64)  # output characters per input character, at each of two attempts
_UNDEFINED = "\uf8ff"
"""Character that no table defines. Its output shows how a table marks undefined characters."""
_ESCAPE = re.compile(r"\\([0-9A-F]*)/")  # output for an undefined cell: the numbers of its dots

_TAG_OF = {"zh": "cmn-Hans", "cmn": "cmn-Hans", "nb": "no", "nn": "no"}
"""Language tags of liblouis that differ from common ones."""
_PLAIN_KINDS = (" contraction:no dots:6", " contraction:no", " grade:1")
_PLAIN_ENDS = ("-g0.utb", "-g0.ctb", "-g1.utb", "-g1.ctb", ".utb", ".ctb", ".tbl")
_TEST_LETTERS = {"he": "אבג"}
"""Letters of the decoding test, by language; abc for all other languages. A Hebrew table may decode
abc, but no Hebrew letters."""

_lock = threading.Lock()  # liblouis has global state


class LouisCode:
    """Braille code of a liblouis table, given by file name, such as ``en-ueb-g2.ctb``."""

    def __init__(self, table: str, goes_back: bool | None = None) -> None:
        if not has_table(table):
            raise BrailleError(f"liblouis does not have the table {table!r}: {INSTALL}")
        self._table = table
        self.goes_back: bool = _goes_both_ways(table) if goes_back is None else goes_back

    def missing(self, line: str) -> str:
        """Return the characters of a line that the table does not define, each once."""
        return "".join(
            character for character in dict.fromkeys(line) if not _defines(self._table, character)
        )

    def encode(self, line: str) -> str:
        """Return a line of text as cells."""
        return _translate(self._table, line, _DOTS_IO | _UNICODE_CELLS)

    def decode(self, cells: str) -> str:
        """Translate cells to text; undefined cells stay unchanged."""
        dots = "".join(chr(_DOTS | pattern(cell)) for cell in cells)
        text = _translate(self._table, dots, _DOTS_IO, back=True)
        if text == _translate(self._table, dots, _DOTS_IO | _NO_UNDEFINED, back=True):
            return text
        return _ESCAPE.sub(lambda match: _cell(match[1]), text)


@cache
def _defines(table: str, character: str) -> bool:
    """Return whether a table defines a character."""
    if unicodedata.category(character).startswith("C") and character not in (*JOINERS, "\xad"):
        return False
    if _encoding() == "utf-16-le" and ord(character) > 0xFFFF:
        return False
    mode = _DOTS_IO | _UNICODE_CELLS | _NO_UNDEFINED
    alone, undefined = (
        _translate(table, character_tried, mode) for character_tried in (character, _UNDEFINED)
    )
    # Some tables translate undefined characters to a question mark or a blank.
    return alone != undefined or (character.isascii() and bool(undefined))


def version() -> str | None:
    """Return the version of liblouis; None if it is not installed."""
    return _query("lou_version") or None


def has_table(table: str) -> bool:
    """Return whether liblouis is installed and has a usable table of this name."""
    library = _library()
    if library is None or not table.isprintable() or len(table.encode()) > _LONGEST_NAME:
        return False
    if not all(table.split(",")):
        # liblouis reads out of bounds for an empty name.
        return False
    with _lock:
        return bool(library.lou_checkTable(table.encode()))


def find_table(language: str) -> str | None:
    """Return the file name of the table for a language tag such as ``pt-BR``. If there are several
    tables, return the table with the fewest contractions. If there is no table for the country
    (BR), return a table for the language (pt)."""
    tag = _TAG_OF.get(language) or _TAG_OF.get(language.partition("-")[0]) or language
    main_language = tag.partition("-")[0].lower()

    def described(*kinds: str) -> Iterator[str]:
        for tag_form, kind in itertools.product((tag, main_language), kinds):
            table_name = _query(
                "lou_findTable", f"language:{tag_form} type:literary{kind}".encode()
            )
            # liblouis may return tables of other languages.
            if table_name and main_language == language_of(table_name).partition("-")[0]:
                yield table_name.rpartition("/")[2]

    def named(start: str, ends: Sequence[str] = _PLAIN_ENDS) -> Iterator[str]:
        return (start + end for end in ends if has_table(start + end))

    candidates = itertools.chain(
        named(language.lower()) if "-" in language else (),
        described(*_PLAIN_KINDS), named(main_language, _PLAIN_ENDS[:4]),
        described(""), named(main_language),
    )  # fmt: skip
    return next(candidates, None)


def language_of(table: str) -> str:
    return _query("lou_getTableInfo", table.encode(), b"language")


def _query(function: str, *arguments: bytes) -> str:
    """Call a function of liblouis and return its text; "" if there is no text or no liblouis."""
    library = _library()
    if library is None:
        return ""
    with _lock:
        call = getattr(library, function)
        call.restype = ctypes.c_char_p
        return (call(*arguments) or b"").decode("utf-8", "replace")


@cache
def _library() -> ctypes.CDLL | None:
    library_path = ctypes.util.find_library("louis")
    for name in (*([library_path] if library_path else ()), *_LIBRARIES):
        try:
            library = ctypes.CDLL(name)
        except OSError:
            continue
        # This module raises errors, so liblouis need not write them to stderr.
        library.lou_setLogLevel(_LOG_OFF)
        return library
    return None


def _goes_both_ways(table: str) -> bool:
    """Return whether a table also decodes cells, according to its metadata or a test."""
    if _query("lou_getTableInfo", table.encode(), b"direction") != "forward":
        return True
    code, letters = LouisCode(table, goes_back=True), _TEST_LETTERS.get(language_of(table), "abc")
    try:
        return code.decode(code.encode(letters)) == letters
    except BrailleError:
        return False


@cache
def _encoding() -> str:
    library = _library()
    assert library is not None
    return "utf-32-le" if library.lou_charSize() == 4 else "utf-16-le"


def _translate(table: str, text: str, mode: int, back: bool = False) -> str:
    library, encoding = _library(), _encoding()
    assert library is not None
    translate = library.lou_backTranslate if back else library.lou_translate
    encoded = text.encode(encoding, "surrogatepass")
    width = 4 if encoding == "utf-32-le" else 2
    length = len(encoded) // width
    for ratio in _CAPACITIES:
        capacity = ratio * length + 64
        inbuf = ctypes.create_string_buffer(encoded, len(encoded) + width)
        outbuf = ctypes.create_string_buffer(capacity * width)
        read, written = ctypes.c_int(length), ctypes.c_int(capacity)
        with _lock:
            done = translate(
                table.encode(), inbuf, ctypes.byref(read), outbuf, ctypes.byref(written),
                None, None, None, None, None, mode,
            )  # fmt: skip
        if not done:
            break
        # liblouis can consume all input but cut off output: retry if the buffer is over half full.
        if read.value == length and written.value <= capacity // 2:
            return outbuf.raw[: written.value * width].decode(encoding, "replace")
    way = "cells to text" if back else "text to cells"
    raise BrailleError(f"liblouis could not translate {way} with {table}: choose another table")


def _cell(dots: str) -> str:
    """Return the cell of dots given as digits, as in 1256. Other characters are ignored."""
    return chr(ord(BLANK) | sum(1 << int(dot) - 1 for dot in dots if dot in "12345678"))
