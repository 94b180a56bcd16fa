"""Built-in Japanese kana Braille: kana as they are spelled, numbers and punctuation."""

import unicodedata

from smarttouch.braille.cells import BLANK

# Dots 1, 2 and 4 are the vowel, 3, 5 and 6 the consonant; a prefix cell modifies a syllable.
# Checked against the kana of liblouis' ja-kantenji table.
_ROWS = {
    "あいうえお": "⠁⠃⠉⠋⠊", "かきくけこ": "⠡⠣⠩⠫⠪", "さしすせそ": "⠱⠳⠹⠻⠺",
    "たちつてと": "⠕⠗⠝⠟⠞", "なにぬねの": "⠅⠇⠍⠏⠎", "はひふへほ": "⠥⠧⠭⠯⠮",
    "まみむめも": "⠵⠷⠽⠿⠾", "やゆよ": "⠌⠬⠜", "らりるれろ": "⠑⠓⠙⠛⠚",
    "わゐゑを": "⠄⠆⠖⠔", "んっー": "⠴⠂⠒",
}  # fmt: skip
_PLAIN = {kana: cell for row, cells in _ROWS.items() for kana, cell in zip(row, cells, strict=True)}
_VOICED = dict(
    zip("がぎぐげござじずぜぞだぢづでどばびぶべぼゔ", "かきくけこさしすせそたちつてとはひふへほう",
        strict=True)
)  # fmt: skip
_HALF_VOICED = dict(zip("ぱぴぷぺぽ", "はひふへほ", strict=True))
_FULL_SIZE = dict(zip("ぁぃぅぇぉゃゅょゎヵヶ", "あいうえおやゆよわかか", strict=True))
"""Full kana of each small one that belongs to no syllable below."""


def _syllables() -> dict[str, str]:
    """Return the cells of all syllables."""
    table = dict(_PLAIN)
    table |= {kana: "⠐" + _PLAIN[plain] for kana, plain in _VOICED.items()}
    table |= {kana: "⠠" + _PLAIN[plain] for kana, plain in _HALF_VOICED.items()}
    glides = list(zip("ゃゅょ", range(3), strict=True))
    for first, row, mark in (
        ("き", "かくこ", "⠈"), ("ぎ", "かくこ", "⠘"), ("し", "さすそ", "⠈"), ("じ", "さすそ", "⠘"),
        ("ち", "たつと", "⠈"), ("ぢ", "たつと", "⠘"), ("に", "なぬの", "⠈"), ("ひ", "はふほ", "⠈"),
        ("び", "はふほ", "⠘"), ("ぴ", "はふほ", "⠨"), ("み", "まむも", "⠈"), ("り", "らるろ", "⠈"),
    ):  # fmt: skip
        table |= {first + small: mark + _PLAIN[row[k]] for small, k in glides}
    for mark, spelled in (
        ("⠈", "しぇせ ちぇて すぃし てぃち いぇえ きぇけ にぇね ひぇへ"),
        ("⠘", "じぇせ ずぃし でぃち"),
        ("⠢", "うぃい うぇえ うぉお つぁた つぃち つぇて つぉと とぅつ ふぁは ふぃひ ふぇへ ふぉほ "
              "くぁか くぃき くぇけ くぉこ"),
        ("⠲", "ゔぁは ゔぃひ ゔぇへ ゔぉほ どぅつ ぐぁか"),
        ("⠨", "てゅつ ふゅゆ"), ("⠸", "でゅつ ゔゅゆ"),
    ):  # fmt: skip
        table |= {each[:2]: mark + _PLAIN[each[2]] for each in spelled.split()}
    return table


_SYLLABLES = _syllables()
_DIGITS = dict(zip("1234567890", "⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚", strict=True))
_NUMBER, _JOIN = "⠼", "⠤"
"""Number sign, and join between a number and a kana whose cell is also a digit."""
_POINT, _COMMA = "⠂", "⠄"

_BRACKETS = {"「": "⠤", "」": "⠤", "『": "⠰⠤", "』": "⠤⠆", "(": "⠶", ")": "⠶"}
_STOPS = {"。": "⠲", "、": "⠰", "?": "⠢", "!": "⠖", "・": "⠐"}
_BLANKS = {"。": 2, "?": 2, "!": 2, "、": 1, "・": 1}  # blank cells that follow a stop in a line
_UNPARTED = frozenset("」』)。、?!・…~,.")  # signs not separated from a stop by a blank cell
_SIGNS = {**_BRACKETS, **_STOPS, "~": "⠤⠤", "…": "⠂⠂⠂"}
_KNOWN = frozenset({*_SYLLABLES, *_FULL_SIZE, *_DIGITS, *_SIGNS, *" ,."})


class Kana:
    """Kana Braille.

    Katakana become hiragana. Cells are not translated back. Kana are translated as spelled: the
    writer writes the particles は and へ as わ and え, a long う as ー, and spaces between words.
    """

    goes_back = False

    def missing(self, line: str) -> str:
        """Return the characters of a line that have no cells here, each once."""
        return "".join(
            each for each in dict.fromkeys(line) if not _KNOWN.issuperset(_to_hiragana(each))
        )

    def encode(self, line: str) -> str:
        """Return a line of text as cells."""
        text = _to_hiragana(line)
        cells: list[str] = []
        place, numeric = 0, False
        while place < len(text):
            character = text[place]
            if character in _DIGITS:
                cells.append(_DIGITS[character] if numeric else _NUMBER + _DIGITS[character])
                numeric = True
                place += 1
                continue
            if character in ",.":
                if numeric and text[place + 1 : place + 2] in _DIGITS:
                    cells.append(_COMMA if character == "," else _POINT)
                    place += 1
                    continue
                character = {",": "、", ".": "。"}[character]
            syllable, length = _syllable(text, place)
            if syllable:
                if numeric and syllable in _DIGITS.values():
                    cells.append(_JOIN)
                cells.append(syllable)
            else:
                length = 1
                cells.append(BLANK if character == " " else _SIGNS[character])
                following = text[place + 1 :].lstrip(" ")
                if character in _STOPS and following and following[0] not in _UNPARTED:
                    cells.append(BLANK * _BLANKS[character])
                    length = len(text) - place - len(following)
            numeric = False
            place += length
        return "".join(cells)


def _to_hiragana(text: str) -> str:
    """Return a text with full-width digits made plain and katakana made hiragana."""
    plain = unicodedata.normalize("NFKC", text).replace("...", "…").replace("〜", "~")
    return "".join(
        chr(ord(each) - ord("ァ") + ord("ぁ")) if "ァ" <= each <= "ヴ" else each for each in plain
    )


def _syllable(text: str, place: int) -> tuple[str, int]:
    """Return the cells of the syllable at a place, and its number of characters."""
    for length in (2, 1):
        cells = _SYLLABLES.get(text[place : place + length])
        if cells:
            return cells, length
    full = _FULL_SIZE.get(text[place])
    return (_PLAIN[full], 1) if full else ("", 0)
