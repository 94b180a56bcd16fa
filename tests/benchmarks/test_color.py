"""Traces recovered from tactile colors that were split, mixed and delivered.

Run with::

    pytest tests/benchmarks/test_color.py --benchmark-only -n0

Each class alone, every pair, and all three: rate and drive of every class, told from the
currents that an emulated board delivered, beside what it had answered; how far pulses
were from their own time. Then who answers where from 5 to 500 Hz.
"""

import itertools

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.instruments.receptor_responses import split_trace
from smarttouch.instruments.skin_trace import open_trace

from ..instruments.test_color_delivered import ALONE, feel


@pytest.fixture
def seconds(quick):
    return 1.0 if quick else 10.0


def mixtures():
    for count in (1, 2, 3):
        for classes in itertools.combinations(Afferent, count):
            yield "+".join(ALONE[each][0] for each in classes)


def test_what_comes_back(profile, bank, row, quick, seconds):
    specs = list(mixtures())
    for spec in specs[-1:] if quick else specs:
        got = feel(spec, profile, bank, seconds=seconds)
        answers = split_trace(open_trace(spec, seconds), sai_full_n=profile.force.full_n)
        for afferent, found in got.items():
            answer = answers[afferent]
            row(
                "Colors split, mixed and delivered",
                {
                    "felt": spec,
                    "class": afferent.name,
                    "answered, Hz": f"{len(answer.spike_s) / seconds:.1f}",
                    "drive": f"{answer.drive.mean():.2f}",
                    "delivered, Hz": f"{found.rate_hz:.1f}",
                    "drive delivered": f"{found.drive.mean():.2f}",
                },
            )
        spread = {each: answers[each].drive.max() for each in Afferent if each not in got}
        assert max(spread.values(), default=0) < 0.01


def test_who_answers_where(row, quick):
    rates_hz = (5, 10, 15, 20, 30, 45, 60, 75, 100, 150, 250, 400, 500)
    for hz in rates_hz[::6] if quick else rates_hz:
        cells = {"Hz": hz}
        for um in (3, 10, 100):
            answers = split_trace(open_trace(f"tone:{hz}Hz,{um}um", 1.0))
            for each in Afferent:
                cells[f"{um} µm: {each.name}"] = f"{np.median(answers[each].drive):.2f}"
        row("Who answers where", cells)
