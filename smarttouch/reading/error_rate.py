"""Error rates of a recognized text against the true one."""

import unicodedata
from collections.abc import Sequence

from rapidfuzz.distance import Levenshtein

from smarttouch.errors import ReadingError

_SAME_SIGNS = str.maketrans(
    dict.fromkeys("‘’‚‛′`´", "'")
    | dict.fromkeys("“”„‟″«»", '"')
    | dict.fromkeys("‐‑‒–—―−", "-")
    | {"\N{SOFT HYPHEN}": ""}
)
"""Signs that differ only by typeface or style."""


def normalize(text: str) -> str:
    """Return a text without differences of typeface.

    Signs are taken apart and together again by Unicode's NFKC (ligatures become
    letters, an ellipsis three points), quotation marks and dashes become their
    plain forms, and white space, line breaks too, becomes single spaces. Upper
    and lower case stay.
    """
    # Before NFKC, which makes a space and a joining accent of a lone one, and after, as it makes
    # some of these signs from others.
    text = unicodedata.normalize("NFKC", text.translate(_SAME_SIGNS)).translate(_SAME_SIGNS)
    return " ".join(text.split())


def character_error_rate(truth: str, text: str) -> float:
    """Return the Levenshtein distance of normalized texts per character of the truth.

    It is 0 for equal texts and above 1 where more was read than is there.
    """
    return _rate(normalize(truth), normalize(text))


def word_error_rate(truth: str, text: str) -> float:
    """Return the Levenshtein distance of normalized texts in words, per word of the truth."""
    return _rate(normalize(truth).split(), normalize(text).split())


def _rate(truth: Sequence[str], text: Sequence[str]) -> float:
    if not truth:
        raise ReadingError(
            "the text to compare with is empty: give the text of the page", about="truth"
        )
    return Levenshtein.distance(truth, text) / len(truth)
