"""Which side of the paper cells were read from: Braille is no language in a mirror.

Dots of the back are dents in the front. Lit from the other end they look raised, and their cells
are read mirrored: with dots 4 to 6 where 1 to 3 belong.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

SURE = 20.0
"""Log odds beyond which a side is no matter of doubt: one in five hundred million by the cells'
frequencies, which are not independent of each other."""
DIGITS = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
"""Counts from 0 to 61, a character each."""
# Cells of 300, in English, German, French, Spanish, Russian and Chinese, from the pattern 0 on.
# Made by python -m tests.braille.mirror_odds.
FREQUENT = (
    "0p25052903c315f23n0d3m0g0m063mk240300602013221641050010001a10300",
    "0g9764140i9904g00K16131i0l0d0y9001110a30013110120104100002420011",
    "0k22610f41q519h11s041b0i0d261fj200240809610112100071101121100076",
    "0z28600h08h02cj00z060p0j0j840la200000804400040000000000000020400",
    "0v45090b00g00ii50f040A0g0g500fg404000200000402920054050000g00020",
    "0ch0e9nb02c02802e03o38520648203403800563038360030i22c62000525062",
)
_ANY = 0.05  # share of cells of other languages


def mirrored(patterns: NDArray[np.int_]) -> NDArray[np.int_]:
    """Return cells of six dots as they are seen from behind."""
    return np.asarray(patterns >> 3 & 7 | (patterns & 7) << 3)


def unmirrored_odds(patterns: NDArray[np.int_]) -> float:
    """Return the log odds that cells, in their order, are not seen in a mirror.

    Repeated cells, such as lines and leaders, count once.
    """
    once = patterns[np.diff(patterns, prepend=-1) != 0]
    logs = _logs()
    as_read, from_behind = (logs[:, each].sum(axis=1) for each in (once, mirrored(once)))
    return float(np.logaddexp.reduce(as_read) - np.logaddexp.reduce(from_behind))


@cache
def _logs() -> NDArray[np.float64]:
    """Return log frequencies, (L, 64), of cells in each language."""
    counts = np.array([[DIGITS.index(each) for each in row] for row in FREQUENT], float)
    return np.asarray(np.log((1 - _ANY) * counts / counts.sum(axis=1, keepdims=True) + _ANY / 63))
