"""A thousand sentences a table, from text to cells and back to text."""

import pytest

from smarttouch.braille.code_tables import open_table

from .liblouis import needs_liblouis
from .sentences import make_sentences

SAME = str.maketrans(
    {"“": '"', "”": '"', "„": '"', "«": '"', "»": '"', "’": "'", "—": "-", "–": "-"}
)


def share_back(table, language, fold):
    """Return the share of a thousand sentences that come back, their likes taken for the same."""
    sentences = make_sentences(language)
    back = table.to_text(table.to_cells("\n".join(sentences))).split("\n")
    assert len(set(sentences)) == len(back) == 1000
    return sum(fold(a) == fold(b) for a, b in zip(sentences, back, strict=True)) / 1000


def quotes(text):
    """Forms of quotes and dashes are the same."""
    return text.translate(SAME)


def case(text):
    """Small and capital letters, too, are the same."""
    return quotes(text).lower()


@needs_liblouis
@pytest.mark.parametrize(
    ("name", "language", "fold", "share"),
    [
        ("en-1", "english", str, 1),
        # The rest: capitals of whole passages come back small, "U.S." as "U.So.".
        ("en-2", "english", quotes, 0.86),
        # German Braille has no capitals; the rest: brackets, and numbers after a colon.
        ("de-0", "german", case, 0.86),
        ("de-1", "german", case, 0.86),
        ("fr-1", "french", quotes, 1),
        # The rest: "l'été".
        ("fr-2", "french", quotes, 0.98),
    ],
)  # fmt: skip
def test_tables_of_liblouis(name, language, fold, share):
    assert share_back(open_table(name), language, fold) >= share
