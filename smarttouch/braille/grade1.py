"""Uncontracted English Braille (Unified English Braille, grade 1)."""

import itertools
import re
import unicodedata
from collections.abc import Callable
from functools import cache, partial

from smarttouch.braille.cells import BLANK

# Source of rules and signs: The Rules of Unified English Braille, second edition (International
# Council on English Braille, 2013). Sections: 4 letters and accents, 6 numeric mode,
# 7 punctuation, 8 capitals, 11.3 superscripts and subscripts.
_LETTERS = dict(zip("abcdefghijklmnopqrstuvwxyz", "⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚⠅⠇⠍⠝⠕⠏⠟⠗⠎⠞⠥⠧⠺⠭⠽⠵", strict=True))
_DIGITS = dict(zip("1234567890", "⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚", strict=True))
_ACCENTS = {
    "\u0300": "⠘⠡", "\u0301": "⠘⠌", "\u0302": "⠘⠩", "\u0303": "⠘⠻", "\u0308": "⠘⠒",
    "\u030a": "⠘⠫", "\u030c": "⠘⠬", "\u0327": "⠘⠯",
}  # fmt: skip
"""Cells of each accent; the key is its combining mark. They precede the cells of the letter."""
_SIGNS = {
    " ": BLANK, ".": "⠲", ",": "⠂", ";": "⠆", ":": "⠒", "!": "⠖", "'": "⠄", "-": "⠤",
    "–": "⠠⠤", "—": "⠠⠤", "‘": "⠠⠦", "’": "⠠⠴", "«": "⠸⠦", "»": "⠸⠴",
    "(": "⠐⠣", ")": "⠐⠜", "[": "⠨⠣", "]": "⠨⠜", "{": "⠸⠣", "}": "⠸⠜", "<": "⠈⠣", ">": "⠈⠜",
    "/": "⠸⠌", "\\": "⠸⠡", "|": "⠸⠳", "_": "⠨⠤", "#": "⠸⠹", "%": "⠨⠴", "&": "⠈⠯", "@": "⠈⠁",
    "*": "⠐⠔", "+": "⠐⠖", "=": "⠐⠶", "×": "⠐⠦", "÷": "⠐⠌", "~": "⠈⠔", "^": "⠈⠢", "•": "⠸⠲",
    "$": "⠈⠎", "£": "⠈⠇", "€": "⠈⠑", "¢": "⠈⠉", "¥": "⠈⠽",
    "°": "⠘⠚", "§": "⠘⠎", "¶": "⠘⠏", "©": "⠘⠉", "®": "⠘⠗", "™": "⠘⠞",
}  # fmt: skip

_LEVELS = {"^": "⠔", "_": "⠢"}
_SCRIPT = re.compile(
    r"((?<=[\w)])\^|(?<=(?<![^\W\d_])[^\W\d_])_|(?<=[A-Z)])_)"
    r"(\d+(?:[.,]\d+)*|[a-z](?![^\W\d_])|[-−]\d+|\((?:[^\W_]|[-−+=., ])+\))"
)
"""Superscript, as in 10^6 and a^(n+1), or subscript. A subscript must follow a single letter, a
capital or a closing parenthesis."""
_SCRIPT_CELLS = re.compile("⠰?([⠔⠢])(?:(⠼[⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚]+(?:[⠂⠲][⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚]+)*)|⠣((?:(?!⠜).)+)⠜|(.))")
_NUMBER_AT_END = re.compile("⠼[⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚⠂⠲]+$")
_DIGIT_AT_START = re.compile("^([⠂⠲]*)(?=[⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚])")
_LETTER_AT_END = re.compile(f"(?<![^{BLANK}])([{''.join(_LETTERS.values())}])$")
_MINUS = "⠐⠤"

_CAPITAL, _CAPITAL_WORD, _CAPITAL_PASSAGE, _CAPITALS_END = "⠠", "⠠⠠", "⠠⠠⠠", "⠠⠄"
_NUMBER, _GRADE_1, _NUMBER_SPACE = "⠼", "⠰", "⠐"
_ONE_QUOTE_OR_QUESTION, _CLOSING_QUOTE, _ANY_QUOTE, _SURE_QUOTE = "⠦", "⠴", "⠠⠶", "⠘⠦"
_OPENING = frozenset(" ([{<–—-/‘«")
"""After these signs and at a line's start, ⠦ opens a quotation. Elsewhere, it is a ? (Rule 7.5)."""

_LETTER_OF = {cell: letter for letter, cell in _LETTERS.items()}
_DIGIT_OF = {cell: digit for digit, cell in _DIGITS.items()}
_ACCENT_OF = {cells: accent for accent, cells in _ACCENTS.items()}
_SIGN_OF = {cells: sign for sign, cells in _SIGNS.items()} | {
    _ANY_QUOTE: '"', _CLOSING_QUOTE: '"',
}  # fmt: skip


class Grade1:
    """Code for letters, accents, numbers, capitals and punctuation.

    Decoding reverses encoding, except that typographic variants become plain: double quotes are
    straight, and there is one kind of apostrophe and of dash.
    """

    goes_back = True

    def missing(self, line: str) -> str:
        """Return the characters of a line that have no cells, each once."""
        return "".join(sign for sign in dict.fromkeys(line) if not _is_known(sign))

    def encode(self, line: str) -> str:
        """Translate a line of text to cells."""
        return encode_scripts(
            line, self._encode, self._encode, partial(self._encode, opening=False)
        )

    def _encode(self, line: str, opening: bool = True) -> str:
        text = _plain_apostrophes(line)
        before, after = _capitals(text)
        cells: list[str] = []
        numeric = False
        for index, character in enumerate(text):
            following = text[index + 1 : index + 2]
            if index in before:
                cells.append(before[index])
            if character in _DIGITS:
                cells += [_DIGITS[character]] if numeric else [_NUMBER, _DIGITS[character]]
                numeric, opening = True, False
            elif character in ".,":
                after_letter = index > 0 and _is_letter(text[index - 1])
                if following in _DIGITS and not numeric and not after_letter:
                    cells.append(_NUMBER)
                    numeric = True
                cells.append(_SIGNS[character])
                opening = False
            elif _is_letter(character):
                spelled = _letter(character)
                if numeric and index not in before and spelled in _DIGIT_OF:
                    cells.append(_GRADE_1)
                cells.append(spelled)
                numeric = opening = False
            else:
                spelled = _punctuation(character, opening, following)
                cells.append(spelled)
                quoted = spelled in (_ONE_QUOTE_OR_QUESTION, _SURE_QUOTE) and character != "?"
                numeric, opening = False, character in _OPENING or quoted
            if index in after:
                cells.append(after[index])
        return "".join(cells)

    def decode(self, cells: str) -> str:
        """Translate cells to text; unknown cells stay unchanged."""
        text: list[str] = []
        numeric, opening = False, True
        passage = word = capital = False
        index = 0
        while index < len(cells):
            cell, pair = cells[index], cells[index : index + 2]
            if numeric:
                digit = _in_number(cell, pair)
                if digit:
                    text.append(digit)
                    index += 1
                    continue
                numeric = False
            if (match := _SCRIPT_CELLS.match(cells, index)) and (script := _script(match)):
                text.append(script)
                word = capital = opening = False
                index = match.end()
            elif cells.startswith(_CAPITAL_PASSAGE, index):
                passage = True
                index += 3
            elif pair == _CAPITALS_END:
                passage = word = False
                index += 2
            elif pair == _CAPITAL_WORD:
                word = True
                index += 2
            elif cell == _NUMBER and pair[1:] in (*_DIGIT_OF, "⠂", "⠲"):
                numeric, opening, word = True, False, False
                index += 1
            elif cell == _GRADE_1 and pair[1:] in _LETTER_OF:
                index += 1
            elif accented := _letter_at(cells, index):
                letter, length = accented
                text.append(letter.upper() if passage or word or capital else letter)
                capital = opening = False
                index += length
            elif cell == _CAPITAL and pair not in _SIGN_OF:
                capital = True
                index += 1
            else:
                sign, length, opening = _sign_at(cells, index, opening)
                text.append(sign)
                word = capital = False
                index += length
        return "".join(text)


Translator = Callable[[str], str]


def encode_scripts(
    line: str, encode: Translator, encode_item: Translator, encode_rest: Translator | None = None
) -> str:
    """Translate a line by ``encode``, but write superscripts and subscripts in technical notation.
    ``encode_item`` translates the content of a superscript or subscript. ``encode_rest`` (default:
    ``encode``) translates the text that follows a superscript or subscript."""
    cells, end = "", 0
    for script in _SCRIPT.finditer(line):
        item = encode_item(script[2].strip("()")).replace("⠐⠤", "⠤").replace("⠤", _MINUS)
        if script[2][0] in "(-−":
            item = f"⠣{item}⠜"
        cells = _joined(cells, encode(line[end : script.start()]))
        encode = encode_rest or encode
        cells += _GRADE_1 * (not line[script.start() - 1].isdigit()) + _LEVELS[script[1]] + item
        end = script.end()
    return _joined(cells, encode(line[end:]))


def _joined(before: str, after: str) -> str:
    """Join cells. Insert an indicator if a letter would read as a digit of a number."""
    if _NUMBER_AT_END.search(before):
        after = _DIGIT_AT_START.sub(r"\1⠰", after)
    return before + after


def decode_scripts(cells: str, decode: Translator) -> str:
    """Translate technical notation to superscripts and subscripts, and all other cells by
    ``decode``. Cells of technical notation can also be contractions. They are technical notation
    only after a number or a grade 1 indicator."""
    text, end = "", 0
    for match in _SCRIPT_CELLS.finditer(cells):
        is_sure = match[0][0] == _GRADE_1 or _NUMBER_AT_END.search(cells, 0, match.start())
        if is_sure and (script := _script(match)):
            # Mark a single letter, because ``decode`` would read it as a contraction.
            text += decode(_LETTER_AT_END.sub(r"⠰\1", cells[end : match.start()])) + script
            end = match.end()
    return text + decode(cells[end:])


def _script(match: re.Match[str]) -> str:
    """Return the superscript or subscript in matched cells; empty if the match is neither."""
    level, number, group, letter = match.groups()
    mark = next(mark for mark, cell in _LEVELS.items() if cell == level)
    inner = Grade1().decode((number or group or letter).replace(_MINUS, _SIGNS["-"]))
    if letter and not inner.isalpha():
        return ""
    is_item = not group or re.fullmatch(r"-\d+", inner)
    return f"{mark}{inner}" if is_item else f"{mark}({inner})"


def _plain_apostrophes(text: str) -> str:
    """Replace ’ by an apostrophe unless it closes a ‘."""
    closed = re.sub(r"(‘[^‘’]*(?:’(?=\w)[^‘’]*)*)’(?!\w)", "\\1\0", text)
    return closed.replace("’", "'").replace("\0", "’")


def _is_known(character: str) -> bool:
    signs = character in _SIGNS or character in '?"“”'
    return signs or character in _DIGITS or _is_letter(character)


def _is_letter(character: str) -> bool:
    return bool(_letter(character))


@cache
def _letter(character: str) -> str:
    """Return the cells of a letter, accents first; empty if the character is not a letter."""
    spelled = unicodedata.normalize("NFD", character.lower())
    letter, marks = spelled[0], spelled[1:]
    if letter not in _LETTERS or not all(mark in _ACCENTS for mark in marks):
        return ""
    return "".join(_ACCENTS[mark] for mark in marks) + _LETTERS[letter]


def _capitals(text: str) -> tuple[dict[int, str], dict[int, str]]:
    """Return two dicts from the index of a character to a capital indicator. The indicators of the
    first dict come before the character, those of the second dict after it."""
    before, after = {}, {}
    capital = [_is_letter(character) and character.isupper() for character in text]
    for is_capital, run in itertools.groupby(range(len(text)), capital.__getitem__):
        places = list(run)
        if is_capital:
            end = places[-1] + 1
            before[places[0]] = _CAPITAL if len(places) == 1 else _CAPITAL_WORD
            if len(places) > 1 and end < len(text) and _is_letter(text[end]):
                after[places[-1]] = _CAPITALS_END
    return before, after


def _punctuation(character: str, opening: bool, following: str) -> str:
    if character == "?":
        return (_GRADE_1 if opening else "") + _ONE_QUOTE_OR_QUESTION
    if character == "“":
        return _ONE_QUOTE_OR_QUESTION if opening else _SURE_QUOTE
    if character == "”":
        return _CLOSING_QUOTE
    if character == '"':
        at_end = following in ("", " ")
        if opening:
            return _ANY_QUOTE if at_end else _ONE_QUOTE_OR_QUESTION
        return _ANY_QUOTE if following.isalnum() else _CLOSING_QUOTE
    return _SIGNS[character]


def _in_number(cell: str, pair: str) -> str:
    """Return the text of a cell in numeric mode; empty if the cell ends the mode."""
    if cell == _NUMBER_SPACE and pair[1:] in _DIGIT_OF:
        return " "
    return {"⠂": ",", "⠲": "."}.get(cell) or _DIGIT_OF.get(cell, "")


def _letter_at(cells: str, index: int) -> tuple[str, int] | None:
    """Return the letter at an index, with accents, and its number of cells."""
    marks, end = "", index
    while cells[end : end + 2] in _ACCENT_OF:
        marks += _ACCENT_OF[cells[end : end + 2]]
        end += 2
    letter = _LETTER_OF.get(cells[end : end + 1])
    if letter is None:
        return None
    return unicodedata.normalize("NFC", letter + marks), end + 1 - index


def _sign_at(cells: str, index: int, opening: bool) -> tuple[str, int, bool]:
    """Return the character at an index, its number of cells, and whether a quotation can open after
    it."""
    cell, pair = cells[index], cells[index : index + 2]
    if pair == _GRADE_1 + _ONE_QUOTE_OR_QUESTION:
        return "?", 2, False
    if pair == _SURE_QUOTE:
        return '"', 2, True
    if cell == _ONE_QUOTE_OR_QUESTION:
        return ('"', 1, True) if opening else ("?", 1, False)
    for length, spelled in ((2, pair), (1, cell)):
        if spelled in _SIGN_OF:
            sign = _SIGN_OF[spelled]
            return sign, length, sign in _OPENING
    return cell, 1, False
