"""An electrode's impedance drifts while a board runs: what was measured keeps the charge.

``SMARTTOUCH_DRIFT_SECONDS=60 pytest tests/boards/test_drift.py --timeout 0 -s`` for the figures.
"""

import functools
import os

import numpy as np
import pytest

from smarttouch.boards.emulator.books import read_slots
from smarttouch.boards.emulator.driver import EmulatorBoard
from smarttouch.boards.probe import one_each
from smarttouch.profile import load_profile
from smarttouch.scan.adaptation import Adaptation
from smarttouch.scan.safety import SafetyLimits

SECONDS = float(os.environ.get("SMARTTOUCH_DRIFT_SECONDS", "1.2"))
DRIFTING, STEADY = 6, 9
LEVEL_MA, WIDTH_US, PERIOD_S = 2.2, 100, 0.02


@pytest.fixture(scope="module")
def delivered(tmp_path_factory, safety_watch):
    """Return what gives the slots of a run at full current, each run done once."""
    return functools.lru_cache(functools.partial(_run, tmp_path_factory, safety_watch))


def _run(tmp_path_factory, watch, kind, hold):
    profile = load_profile("smarttouch-4x4")
    table = profile.model_dump()
    table["pulse"]["width_us"] = WIDTH_US
    table["output"]["kind"] = kind
    profile = type(profile).model_validate(table)
    limits = SafetyLimits.of(profile)
    books = tmp_path_factory.mktemp("books")
    event = f"1 drift {DRIFTING} 4 {SECONDS}"
    with EmulatorBoard("", limits, profile.output, books, [event]) as board:
        adaptation = None
        if hold is not None:
            adaptation = Adaptation(profile, hold, board.capabilities.compliance_v)
        for step in range(int((SECONDS + 1) / PERIOD_S)):
            part = min(1.0, step / 40)
            sequence = one_each(
                limits, round(1000 * LEVEL_MA * part), WIDTH_US, part * LEVEL_MA / limits.full_ma,
                step * int(PERIOD_S * 1e9), cathodic=False, sites=[DRIFTING, STEADY],
                period_us=int(PERIOD_S * 1e6),
            )  # fmt: skip
            if adaptation is not None:
                for given, volts in board.take_volts():
                    adaptation.observe(given, volts)
                sequence = adaptation.apply(sequence)
            board.send(sequence)
        board.drain()
        assert board.report().violations == 0
    watch.judge_books(books, profile, period_us=int(PERIOD_S * 1e6))
    slots = read_slots(books)
    return slots[slots["number"] > slots["number"].min() + 42]


@pytest.mark.parametrize("kind", ["weighted", "three-state"])
def test_charge_is_held_where_adaptation_is_on(delivered, kind):
    found = {}
    for hold in (None, "charge"):
        slots = delivered(kind if hold else "weighted", hold)
        asked = LEVEL_MA * WIDTH_US / 1000
        for site in (DRIFTING, STEADY):
            rows = slots[slots["site"] == site]
            charge = np.abs(rows["charge_uc"][:, site].astype(float)) / asked
            found[hold, site] = (charge.min(), charge.max())
    off, on = found[None, DRIFTING], found["charge", DRIFTING]
    print(
        f"\n{kind}, impedance x 4 in {SECONDS:g} s: delivered charge, of what was asked: "
        f"{off[0]:.3f} to {off[1]:.3f} without (weighted), {on[0]:.3f} to "
        f"{on[1]:.3f} with adaptation"
    )
    assert off[0] < 0.88
    assert 0.95 <= on[0] <= on[1] <= 1.05
    assert found["charge", STEADY] == pytest.approx((1, 1), abs=0.01)


def test_energy_is_held(delivered):
    energy = {}
    for hold in (None, "energy"):
        slots = delivered("weighted", hold)
        rows = slots[slots["site"] == DRIFTING]
        energy[hold] = np.abs(
            rows["charge_uc"][:, DRIFTING].astype(float) * rows["volts"][:, DRIFTING].astype(float)
        )
    spread = {hold: values.max() / values.min() for hold, values in energy.items()}
    print(
        f"\ncurrent x voltage, largest over least: {spread[None]:.2f}, held {spread['energy']:.2f}"
    )
    assert spread[None] > 1.5
    assert spread["energy"] < 1.15
