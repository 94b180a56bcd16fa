"""Grade 1 (uncontracted English Braille): known words, back translation, liblouis as reference."""

import re
import string

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from smarttouch.braille.cells import is_cell
from smarttouch.braille.grade1 import Grade1
from smarttouch.braille.louis import LouisCode

from .needs_liblouis import needs_liblouis

ENGLISH = Grade1()


@pytest.mark.parametrize(("text", "cells"), [
    ("hello", "⠓⠑⠇⠇⠕"),
    ("Hello World", "⠠⠓⠑⠇⠇⠕⠀⠠⠺⠕⠗⠇⠙"),
    ("HELLO", "⠠⠠⠓⠑⠇⠇⠕"),
    ("HELLO WORLD AGAIN.", "⠠⠠⠓⠑⠇⠇⠕⠀⠠⠠⠺⠕⠗⠇⠙⠀⠠⠠⠁⠛⠁⠊⠝⠲"),
    ("TVs", "⠠⠠⠞⠧⠠⠄⠎"),
    ("McDonald", "⠠⠍⠉⠠⠙⠕⠝⠁⠇⠙"),
    ("X-RAY", "⠠⠭⠤⠠⠠⠗⠁⠽"),
    ("123", "⠼⠁⠃⠉"),
    ("3,000.50", "⠼⠉⠂⠚⠚⠚⠲⠑⠚"),
    (".5", "⠼⠲⠑"),
    ("1a 1k 1A", "⠼⠁⠰⠁⠀⠼⠁⠅⠀⠼⠁⠠⠁"),
    ("10:30", "⠼⠁⠚⠒⠼⠉⠚"),
    ("don't", "⠙⠕⠝⠄⠞"),
    ("dogs’ ‘tails’", "⠙⠕⠛⠎⠄⠀⠠⠦⠞⠁⠊⠇⠎⠠⠴"),
    ('"Why?" he said—no', "⠦⠠⠺⠓⠽⠦⠴⠀⠓⠑⠀⠎⠁⠊⠙⠠⠤⠝⠕"),
    ("?", "⠰⠦"),
    ("(a) [b] {c}", "⠐⠣⠁⠐⠜⠀⠨⠣⠃⠨⠜⠀⠸⠣⠉⠸⠜"),
    ("5% & £5, €5, $5", "⠼⠑⠨⠴⠀⠈⠯⠀⠈⠇⠼⠑⠂⠀⠈⠑⠼⠑⠂⠀⠈⠎⠼⠑"),
    ("20°C", "⠼⠃⠚⠘⠚⠠⠉"),
    ("1 + 1 = 2", "⠼⠁⠀⠐⠖⠀⠼⠁⠀⠐⠶⠀⠼⠃"),
    ("café, Éa, CAFÉ", "⠉⠁⠋⠘⠌⠑⠂⠀⠠⠘⠌⠑⠁⠂⠀⠠⠠⠉⠁⠋⠘⠌⠑"),
    ("ABC 1A DEF", "⠠⠠⠁⠃⠉⠀⠼⠁⠠⠁⠀⠠⠠⠙⠑⠋"),
    ("10^6 x^2 10^-3", "⠼⠁⠚⠔⠼⠋⠀⠭⠰⠔⠼⠃⠀⠼⠁⠚⠔⠣⠐⠤⠼⠉⠜"),
    ("H_2O, a^(n+1), x_n", "⠠⠓⠰⠢⠼⠃⠠⠕⠂⠀⠁⠰⠔⠣⠝⠐⠖⠼⠁⠜⠂⠀⠭⠰⠢⠝"),
    ("x^2a x^2k x^n0 x_1,b", "⠭⠰⠔⠼⠃⠰⠁⠀⠭⠰⠔⠼⠃⠅⠀⠭⠰⠔⠝⠼⠚⠀⠭⠰⠢⠼⠁⠂⠰⠃"),
    ("file_2 ^_^", "⠋⠊⠇⠑⠨⠤⠼⠃⠀⠈⠢⠨⠤⠈⠢"),
])  # fmt: skip
def test_known_words(text, cells):
    assert ENGLISH.encode(text) == cells


@pytest.mark.parametrize(("cells", "text"), [
    ("⠼⠁⠐⠚⠚⠚", "1 000"), ("⠰⠭⠀⠰⠁", "x a"), ("⠠⠠⠠⠁⠀⠼⠃⠀⠉⠠⠄⠀⠙", "A 2 C d"), ("⠓⠊⠦", "hi?"),
    ("⠦⠓⠊⠴", '"hi"'), ("⣿⠓⠿⠸", "⣿h⠿⠸"),
])  # fmt: skip
def test_cells_of_others(cells, text):
    assert ENGLISH.decode(cells) == text


SIGNS = "?.,;:!'-—‘’«»()[]{}<>/\\|_#%&@*+=×÷~^•$£€¢¥°§¶©®™\"“”– "
SAME = str.maketrans({"“": '"', "”": '"', "–": "—", "’": "'"})
LINES = st.text(st.sampled_from(string.ascii_letters + string.digits + "éÉñçÅ" + SIGNS))


@given(LINES)
@example('A B C\'D’ ‘e’ 1.a,b 2 ..5 ?"?" x"y “?” x“ —“ –?')
@example("ABC DEF GHI1 2. 3")
@example('0^0" 0^a0 x^2"')
def test_its_own_cells_come_back(text):
    assert ENGLISH.missing(text) == ""
    cells = ENGLISH.encode(text)
    assert all(map(is_cell, cells))
    assert ENGLISH.decode(cells).translate(SAME) == text.translate(SAME)


LETTERS = st.text(st.sampled_from(string.ascii_lowercase), min_size=1, max_size=6)
WORDS = st.one_of(
    LETTERS, LETTERS.map(str.capitalize), LETTERS.map(str.upper),
    st.builds("{}{}".format, LETTERS.map(str.capitalize), LETTERS.map(str.upper)),
    st.builds("{}-{}".format, LETTERS.map(str.upper), LETTERS),
    st.sampled_from(["don't", "café", "NAÏVE", "O'Neil", "TVs", "e.g.", "a@b.com", "and/or"]),
    st.from_regex(r"[£$€]?[0-9]{1,3}(,[0-9]{3}|[.:/-][0-9]{2})?(st|nd|km|b|%|°)?", fullmatch=True),
)  # fmt: skip
TOKENS = st.one_of(
    WORDS, WORDS, WORDS,
    st.builds("{}{}".format, WORDS, st.sampled_from([*".,;:!?", "...", "?!"])),
    st.builds("({})".format, WORDS), st.builds("[{}],".format, WORDS),
    st.builds('"{}"'.format, LETTERS), st.builds("“{}.”".format, WORDS),
    st.builds("‘{}.’".format, WORDS),
    st.builds("{}—{}".format, WORDS, WORDS), st.sampled_from(["-", "–", "&", "+", "="]),
)  # fmt: skip


@needs_liblouis
@settings(deadline=None)
@given(st.lists(TOKENS, min_size=1, max_size=8).map(" ".join))
def test_ordinary_text_is_as_liblouis_has_it(text):
    # Unlike `Grade1`, liblouis joins two numbers, and marks 3 words in capitals as a passage.
    apart = re.sub(r"(?<=\d) (?=\d)", " and ", text)
    assume(not re.search(r"(?:[^a-z ]*[A-Z][^a-z ]*(?: [^a-zA-Z]+)? ){2}[^a-z ]*[A-Z]", apart))
    assert ENGLISH.encode(apart) == LouisCode("en-ueb-g1.ctb").encode(apart)
