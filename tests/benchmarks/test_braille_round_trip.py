"""A thousand sentences of each language: text, cells, electrodes, emulator, dots, cells.

Run with::

    pytest tests/benchmarks/test_braille_round_trip.py --benchmark-only -n0

Every sentence moves through the 8 x 8 array on a simulated board, one pulse for each place; dots
that the skin got are decoded and compared with what was asked for.
"""

import os

import pytest

from smarttouch.braille import louis
from smarttouch.braille.code_tables import open_table
from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.reading.braille_lines import Braille
from smarttouch.reading.delivered_lines import LineDelivery, deliver_lines

from ..braille.sentences import make_sentences

COUNT = int(os.environ.get("SMARTTOUCH_SENTENCES", "1000"))
TABLES = {
    "en-1": "english", "en-2": "english", "de-1": "german", "fr-1": "french", "ja": "japanese",
}  # fmt: skip


@pytest.mark.skipif(
    louis.version() is None, reason="needs liblouis: apt install liblouis20 liblouis-data"
)
@pytest.mark.parametrize("name", TABLES)
def test_round_trip(name, row, quick):
    profile = profile_for_reading(load_profile("electric-mouse"))
    braille, table = Braille(name), open_table(name)
    motion = braille.motion(profile, profile.electrodes.cell_mm[0] * profile.pulse.rate_hz)
    reading = LineDelivery(profile, load_bank(profile), braille.tone, motion)
    sentences = make_sentences(TABLES[name])[: 3 if quick else COUNT]
    cells = [table.to_cells(each) for each in sentences]
    layout = braille.layout(profile)

    exact = 0
    lines = deliver_lines([layout.moving((each,)) for each in cells], reading)
    pictures = [each.picture for each in lines]
    for each, picture in zip(cells, pictures, strict=True):
        exact += layout.decode(picture, (each,), apart=False) == (each,)
    row(
        "Sentences that came back from the delivered dots",
        {"table": name, "sentences": len(cells), "exact": exact, "cells": sum(map(len, cells))},
    )
    assert exact == len(cells)
