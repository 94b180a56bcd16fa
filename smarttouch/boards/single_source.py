"""Sequences on boards with one source: one electrode against all others."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import BoardError
from smarttouch.stimulation.sequence import ScanSequence


def one_against_all(sequence: ScanSequence) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return the electrode that each slot drives alone, (S,), and its current, (S,) µA, positive
    cathodic; raise BoardError if a slot is anything else, or an electrode has two."""
    current = sequence.current_ua.astype(np.int64)
    electrode = sequence.site.astype(np.intp)
    rows = np.arange(sequence.slots)
    own = current[rows, electrode]
    others = current * np.sign(own)[:, None]
    others[rows, electrode] = 0
    wrong = (others > 0).any(axis=1) | (np.abs(current).max(axis=1, initial=0) > np.abs(own))
    if wrong.any():
        raise BoardError(
            f"slot {int(wrong.argmax())} is no pattern of one electrode against all others, and "
            "this board can make no other: use its own profile",
            about="current_ua",
            slot=int(wrong.argmax()),
        )
    if len(np.unique(electrode)) != len(electrode):
        raise BoardError(
            f"{len(electrode)} slots share {len(np.unique(electrode))} electrodes: this board "
            "drives each once in a scan",
            about="slots",
        )
    return electrode, own
