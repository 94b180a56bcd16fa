"""Translation by liblouis: contractions, missing characters, unknown tables, and threads."""

import threading

import pytest

from smarttouch.base.errors import BrailleError
from smarttouch.braille.code_tables import open_table
from smarttouch.braille.louis import LouisCode

from ..support.checks import raises
from .needs_liblouis import needs_liblouis


@needs_liblouis
@pytest.mark.parametrize(("table", "text", "cells"), [
    ("en-ueb-g2.ctb", "The child will go.", "⠠⠮⠀⠡⠀⠺⠀⠛⠲"),
    ("en-ueb-g2.ctb", "knowledge for people", "⠅⠀⠿⠀⠏"),
    ("de-g0.utb", "Straße 12", "⠎⠞⠗⠁⠮⠑⠀⠼⠁⠃"),
    ("de-g1.ctb", "schön", "⠱⠪⠝"),
    ("de-g1.ctb", "die Bäume", "⠙⠬⠀⠃⠌⠍⠑"),
    ("de-g2.ctb", "die und", "⠬⠀⠥"),
    ("fr-bfu-comp6.utb", "été garçon", "⠿⠞⠿⠀⠛⠁⠗⠯⠕⠝"),
    ("fr-bfu-comp6.utb", "Où est-il ?", "⠨⠕⠾⠀⠑⠎⠞⠤⠊⠇⠀⠢"),
])  # fmt: skip
def test_known_words(table, text, cells):
    code = LouisCode(table)
    assert code.encode(text) == cells
    if table == "en-ueb-g2.ctb":
        assert code.decode(cells) == text


@needs_liblouis
@pytest.mark.parametrize("table", ["en-ueb-g2.ctb", "fr-bfu-comp6.utb", "da-dk-g26.ctb"])
def test_what_is_missing(table):
    assert LouisCode(table).missing("a é?中\x01😀\ue000 中") == "中\x01😀\ue000"


@needs_liblouis
@pytest.mark.parametrize(
    "table", ["none.ctb", "", ",", "a" * 5000, "two\nlines.ctb", "en-ueb-g1.ctb,no.x"]
)
def test_no_such_table(table, capfd):
    with raises(BrailleError, names="table", value=table.split("\n")):
        LouisCode(table)
    assert capfd.readouterr() == ("", "")


@needs_liblouis
def test_many_threads_at_once():
    tables = {"en-ueb-g2.ctb": "The child", "de-g1.ctb": "schön", "fr-bfu-comp6.utb": "été"}
    expected = {table: LouisCode(table).encode(text) for table, text in tables.items()}
    wrong = []

    def translate(table):
        code = LouisCode(table)
        wrong.extend(table for _ in range(200) if code.encode(tables[table]) != expected[table])

    threads = [threading.Thread(target=translate, args=(table,)) for table in list(tables) * 2]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


@needs_liblouis
@pytest.mark.parametrize(
    ("table", "text", "same"),
    [
        ("fr-1", "e\u0301te\u0301", "\u00e9t\u00e9"),
        ("pa.tbl", "\u0a38\u0a3c\u0a47", "\u0a36\u0a47"),
        ("ar-ar-g1.utb", "\u062f\u0651\u064c", None),
        ("fa-ir-g1.utb", "\u0645\u06cc\u200c\u062e", None),
    ],
    ids=["accents are joined", "decomposed letters", "Arabic marks", "Persian joiners"],
)
def test_texts_stay_as_in_liblouis(table, text, same):
    opened = open_table(table)
    assert opened.losses(text) == ""
    code = LouisCode("fr-bfu-comp6.utb" if table == "fr-1" else table)
    assert opened.to_cells(text) == code.encode(same or text)
