"""Braille tables by name, which translate between text and cells."""

import re
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

from smarttouch.base.errors import BrailleError
from smarttouch.braille import louis
from smarttouch.braille.cells import BLANK, is_cell, require_cells
from smarttouch.braille.grade1 import Grade1, decode_scripts, encode_scripts
from smarttouch.braille.louis import LouisCode
from smarttouch.braille.plain_forms import QUIET, plain_forms

DEFAULT_TABLE = "en-1"
_MARKS = r"[\u0300-\u036f\u064b-\u065f\u0670\u093c\u09bc\u0a3c\u0b3c\u0cbc\u3099\u309a]+"
_MARKED = re.compile(r"[^\W\d_]" + _MARKS)
"""A letter and its combining marks."""
_TYPEFORM = re.compile("[⠨⠘⠸][⠂⠆⠶⠄]")
"""Indicators of emphasis in Unified English Braille (UEB, Rules 9.1). No table decodes them."""
_MOST_NAMED = 12  # largest number of characters listed in a note
_TAG = re.compile(r"[a-z]{2,3}(-[A-Z]{2})?")  # language tag, optionally with a country
MISSING_NOTE = f"liblouis is not installed: only English grade 1 works; for others: {louis.INSTALL}"


BrailleCode = Grade1 | LouisCode
"""Braille code that translates line by line; `goes_back` states whether it also decodes cells."""


@dataclass(frozen=True)
class BrailleTable:
    """Braille code with the name given by the user."""

    name: str
    code: BrailleCode
    note: str | None = None  # warning for the user

    def to_cells(self, text: str, leave_out: bool = False) -> str:
        """Translate a text to cells, line by line.

        A character without cells is replaced by its plain form. A character without a plain form
        is dropped if ``leave_out`` is set; otherwise, it raises BrailleError. See `losses`.
        """
        plain, forms = self._plain(text)
        if not leave_out and "" in forms.values():
            sign, *others = (sign for sign, form in forms.items() if not form)
            more = f" and {len(others)} more" if others else ""
            raise BrailleError(
                f"table {self.name} has no cells for {sign!r} (U+{ord(sign):04X}){more}: leave "
                "them out, or choose another table"
            )
        return "\n".join(self.code.encode(line) for line in plain.split("\n"))

    def losses(self, text: str) -> str:
        """Return a sentence on characters that `to_cells` replaces or drops, or "" for none."""
        signs = self._plain(text)[1].items()
        # UEB has technical notation for superscripts and subscripts, so do not report them.
        quiet = "^_" if self._is_ueb else ""
        forms = {
            sign: form
            for sign, form in signs
            if sign not in QUIET and (form[:1] or " ") not in quiet
        }
        plain = [f"{sign} as {form.strip()}" for sign, form in forms.items() if form]
        lost = [
            sign if sign.isprintable() else f"U+{ord(sign):04X}"
            for sign, form in forms.items() if not form
        ]  # fmt: skip
        kinds = [
            f"{how} {', '.join(signs[:_MOST_NAMED])}{', …' * (len(signs) > _MOST_NAMED)}"
            for how, signs in (("written plainly:", plain), ("left out:", lost)) if signs
        ]  # fmt: skip
        words = f"table {self.name} has no cells for some characters; {'; '.join(kinds)}"
        return words.replace("\xad", "-") if kinds else ""

    def paragraphs(self, text: str, note: Callable[[str], None]) -> list[str]:
        """Translate each line of a text to cells. A text of cells is not translated.

        If characters are lost, ``note`` is called with the sentence that `losses` returns.
        """
        if any(map(is_cell, text)) and all(is_cell(sign) or sign in " \t\n" for sign in text):
            cells = re.sub("[ \t]", BLANK, text)
        else:
            if losses := self.losses(text):
                note(losses)
            cells = self.to_cells(text, leave_out=True)
        return cells.strip("\n").split("\n")

    def _plain(self, text: str) -> tuple[str, dict[str, str]]:
        plain, forms = plain_forms(_tidy(text, self.code), self._lacks)
        return plain, {sign: forms[sign] for sign in dict.fromkeys(text) if sign in forms}

    def _lacks(self, sign: str) -> bool:
        """Return True if the table has no cells for a character. Also return True for a superscript
        that the table translates to a plain digit or to a blank."""
        if sign == "\n":
            return False
        if self.code.missing(sign):
            return True
        figure = unicodedata.normalize("NFKC", sign)
        if figure == sign or not figure.isdigit() or unicodedata.decomposition(sign)[:5] == "<wide":
            return False
        unlike = [self.code.encode(text) for text in (f"1{figure}", "1")]
        return self.code.encode(f"1{sign}").rstrip(BLANK) in unlike

    def to_text(self, cells: str) -> str:
        """Translate cells to text, line by line; unknown cells stay unchanged."""
        code = self.code
        if not code.goes_back:
            raise BrailleError(
                f"table {self.name} only translates text to cells: choose another table to "
                "translate back"
            )
        require_cells(cells.replace("\n", ""))
        return "\n".join(code.decode(self._without_typeforms(line)) for line in cells.split("\n"))

    def _without_typeforms(self, cells: str) -> str:
        """Return cells without indicators of emphasis."""
        return _TYPEFORM.sub("", cells) if self._is_ueb else cells

    @property
    def _is_ueb(self) -> bool:
        return self.name in ("en-1", "en-2")

    def doubt(self, cells: str, text: str) -> str | None:
        """Encode ``text`` and compare the result with ``cells``. Return a sentence about words that
        differ, because ``text`` may be wrong there; None if all words are equal."""
        plain, again = (
            re.split(f"[{BLANK}\n]+", cells_form)
            for cells_form in (self._without_typeforms(cells), self.to_cells(text, leave_out=True))
        )
        wrong = [k for k, pair in enumerate(zip(plain, again, strict=False)) if len(set(pair)) > 1]
        if not wrong:
            return None
        example = "".join(re.split(r"\s+", text)[wrong[0] : wrong[0] + 1])
        return (
            f"{len(wrong)} of {len(plain)} words may be wrong, the first is {example!r}: table "
            f"{self.name} translates these words back to cells that differ from the given cells"
        )


class _EnglishLouis(LouisCode):
    """Unified English Braille by liblouis, with superscripts and subscripts as technical
    notation."""

    def missing(self, line: str) -> str:
        """Return the undefined characters and the superscripts of a line, each once."""
        return "".join(
            sign for sign in dict.fromkeys(line) if sign in "¹²³" or LouisCode.missing(self, sign)
        )

    def encode(self, line: str) -> str:
        uncontracted = LouisCode(_KNOWN["en-1"].file).encode
        return encode_scripts(line, super().encode, uncontracted)

    def decode(self, cells: str) -> str:
        return decode_scripts(cells, super().decode)


class _UncontractedLouis(_EnglishLouis):
    """Uncontracted English code that encodes by liblouis and decodes by `Grade1`.

    Liblouis has more characters, but its decoding lost capitals in 77 of 1000 test sentences.
    """

    def decode(self, cells: str) -> str:
        """Translate cells to text by `Grade1`. Words with cells that `Grade1` does not know are
        decoded by liblouis."""
        text = Grade1().decode(cells)
        if not any(map(is_cell, text)):
            return text
        words, read = zip(cells.split(BLANK), text.split(" "), strict=False), super().decode
        return " ".join(
            read(word) if any(map(is_cell, original)) else original for word, original in words
        )


class _Known(NamedTuple):
    title: str
    file: str  # table of liblouis
    goes_back: bool


# In a test, these tables encoded and decoded 1000 sentences. `goes_back` is False for de-2 and
# en-gb-2, because at most 1 in 30 sentences was unchanged after decoding.
_KNOWN = {
    "en-1": _Known("English (UEB), uncontracted", "en-ueb-g1.ctb", True),
    "en-2": _Known("English (UEB), contracted", "en-ueb-g2.ctb", True),
    "en-us-2": _Known("English, United States before 2016, contracted", "en-us-g2.ctb", True),
    "en-gb-2": _Known("English, Britain before 2015, contracted", "en-GB-g2.ctb", False),
    "de-0": _Known("German, uncontracted", "de-g0.utb", True),
    "de-1": _Known("German, Vollschrift", "de-g1.ctb", True),
    "de-2": _Known("German, Kurzschrift", "de-g2.ctb", False),
    "fr-1": _Known("French, uncontracted", "fr-bfu-comp6.utb", True),
    "fr-2": _Known("French, contracted", "fr-bfu-g2.ctb", True),
}


def known_tables() -> dict[str, str]:
    """Return the titles of tables that have a short name."""
    return {name: known.title for name, known in _KNOWN.items()}


def open_table(name: str = DEFAULT_TABLE) -> BrailleTable:
    """Open a table by short name, by file name of a liblouis table, or by language tag. A tag such
    as ``pt-BR`` names a language; of its tables, the one with the fewest contractions is opened."""
    if _TAG.fullmatch(name):
        language = name.lower().partition("-")[0]
        name = next(
            (known_name for known_name in _KNOWN if known_name.partition("-")[0] == language), None
        ) or (louis.find_table(name) or name)
    known = _KNOWN.get(name)
    if known is None:
        if "." in name and louis.has_table(name):
            return BrailleTable(name, LouisCode(name))
        raise BrailleError(
            f"unknown table {name!r}: choose one of {', '.join(_KNOWN)}, or give the tag of a "
            "language (pt), or the file name of a table of liblouis"
        )
    if louis.has_table(known.file):
        code = {"en-1": _UncontractedLouis, "en-2": _EnglishLouis}.get(name, LouisCode)
        return BrailleTable(name, code(known.file, known.goes_back))
    if name != DEFAULT_TABLE:
        raise BrailleError(f"table {name} ({known.title}) needs liblouis: {louis.INSTALL}")
    return BrailleTable(name, Grade1(), MISSING_NOTE)


def _tidy(text: str, code: BrailleCode) -> str:
    """Return a text with plain spaces and composed letters. Drop invisible characters except
    joiners.

    Letters are composed one by one, because normalization of the whole text would reorder Arabic
    marks and decompose Punjabi letters.
    """
    plain = re.sub(r"[^\S\n]", " ", text.replace("\r\n", "\n"))
    visible = "".join(
        character
        for character in plain
        if unicodedata.category(character) != "Cf" or character in louis.JOINERS
    )

    def joined(match: re.Match[str]) -> str:
        letter = match[0]
        one = unicodedata.normalize("NFC", letter)
        if len(one) == len(letter):
            one = _excluded().get(letter, letter)
        return letter if code.missing(one) else one

    tidy = _MARKED.sub(joined, visible)
    return tidy.translate(
        {ord(character): "" for character in louis.JOINERS if code.missing(character)}
    )


@cache
def _excluded() -> dict[str, str]:
    """Map decomposed letters to composed ones, for letters that NFC does not compose."""
    every = map(chr, range(0x0900, 0x1000))
    return {
        parts: character
        for character in every
        if len(parts := unicodedata.normalize("NFC", character)) > 1
    }
