"""Kana Braille: known words, and kana as liblouis has them."""

import pytest

from smarttouch.braille import louis
from smarttouch.braille.cells import cells_to_dots, dots_to_cells
from smarttouch.braille.kana import Kana
from smarttouch.braille.louis import LouisCode

JAPANESE = Kana()
NATIVE = """
あ い う え お か き く け こ さ し す せ そ た ち つ て と な に ぬ ね の は ひ ふ へ ほ
ま み む め も や ゆ よ ら り る れ ろ わ を ん っ が ぎ ぐ げ ご ざ じ ず ぜ ぞ だ ぢ づ で ど
ば び ぶ べ ぼ ぱ ぴ ぷ ぺ ぽ きゃ きゅ きょ ぎゃ ぎゅ ぎょ しゃ しゅ しょ じゃ じゅ じょ
ちゃ ちゅ ちょ にゃ にゅ にょ ひゃ ひゅ ひょ びゃ びゅ びょ ぴゃ ぴゅ ぴょ みゃ みゅ みょ
りゃ りゅ りょ
"""


@pytest.mark.parametrize(
    ("text", "cells"),
    [
        ("あかさたな", "⠁⠡⠱⠕⠅"),
        ("はまやらわん", "⠥⠵⠌⠑⠄⠴"),
        ("がっこー", "⠐⠡⠂⠪⠒"),
        ("ぽち", "⠠⠮⠗"),
        ("きゅーしゅー", "⠈⠩⠒⠈⠹⠒"),
        ("ぎょーざ", "⠘⠪⠒⠐⠱"),
        ("ぴょん", "⠨⠮⠴"),
        ("ファミリー", "⠢⠥⠷⠓⠒"),
        ("25にち", "⠼⠃⠑⠇⠗"),
        ("６えん", "⠼⠋⠤⠋⠴"),
        ("1,000えん", "⠼⠁⠄⠚⠚⠚⠤⠋⠴"),
        ("3.5ど", "⠼⠉⠂⠑⠐⠞"),
        ("はい。そー、です", "⠥⠃⠲⠀⠀⠺⠒⠰⠀⠐⠟⠹"),
        ("「はい。」と", "⠤⠥⠃⠲⠤⠞"),
        ("なに？ すごい！", "⠅⠇⠢⠀⠀⠹⠐⠪⠃⠖"),
        ("『ほん』（あお）", "⠰⠤⠮⠴⠤⠆⠶⠁⠊⠶"),
        ("あぁ", "⠁⠁"),
    ],
)
def test_known_words(text, cells):
    assert JAPANESE.missing(text) == ""
    assert JAPANESE.encode(text) == cells


def lifted(cells):
    """Return cells with all dots one row higher: kana lie low among the 8 dots of Kantenji."""
    dots = cells_to_dots(cells)
    assert not dots[:, [0, 3]].any()
    return dots_to_cells(dots[:, [1, 2, 6, 4, 5, 7]])


@pytest.mark.skipif(
    not louis.has_table("ja-kantenji.utb"), reason=f"needs liblouis: {louis.INSTALL}"
)
def test_kana_are_as_liblouis_has_them():
    table = LouisCode("ja-kantenji.utb")
    # Foreign sounds it spells kana by kana, if they are hiragana, and katakana it marks.
    for kana in NATIVE.split():
        assert lifted(table.encode(kana)) == JAPANESE.encode(kana), kana
