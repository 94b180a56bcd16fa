"""Net charge, class and rate without ``--balance`` and with each way of it, by an emulator's books.

A table: run with ``--benchmark-only -n0``.
"""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.kernels.design_problem import Problem
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline, Regulator
from smarttouch.sources import open_source
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.recharge import ChargeBalance, RechargeRules
from smarttouch.stimulation.scan_sequence import NO_SHARING, SlotPolicy

from ..looping import loop_through
from ..played import played

TEXT = "text:the quick brown fox"
WAYS = ("without", "reversing", "recharging")
SHARED = SlotPolicy((Afferent.RA,))


def regulator_of(way, profile):
    if way == "without":
        return Regulator()
    rules = RechargeRules.of(profile, ScanTiming()) if way == "recharging" else None
    return Regulator(ledger=ChargeBalance(len(profile.electrodes)), recharge=rules)


def answer_of_phase(sequence, profile, bank):
    """Return what a recharge phase reaches of what the most sensitive afferent needs."""
    pulse = profile.pulse
    strength = (1 + pulse.chronaxie_us / pulse.width_us) / (
        1 + pulse.chronaxie_us / sequence.recharge_us
    )
    found = []
    for afferent, receptor in bank.receptor.items():
        full = 1000 * profile.full_ma * (receptor * bank.kernels(afferent)).sum(axis=1)
        found.append((receptor @ sequence.recharge_ua) / full)
    threshold = profile.threshold_ma / profile.full_ma
    return float(strength * np.max(np.stack(found) / threshold))


@pytest.mark.parametrize("scan", ["points", "shared"])
@pytest.mark.parametrize("mode", [Mode.RA, Mode.SAI])
def test_letters(row, quick, profile, bank, mode, scan):
    rows = Problem(profile, mode.afferents[0])
    for way in WAYS:
        answers = [0.0]

        def watch(sent, answers=answers):
            if sent.step.sequence.recharge_us:
                answers.append(answer_of_phase(sent.step.sequence, profile, bank))

        pipeline = Pipeline(
            profile, bank, RunConfig(mode=mode, scan=SHARED if scan == "shared" else NO_SHARING)
        )
        pipeline.regulator = regulator_of(way, profile)
        board = played(profile, SimulatedDriver)
        with board, open_source("text:the" if quick else TEXT, profile) as sensor:
            tally = loop_through(sensor, pipeline, board, watch)
            books = board.driver._firmware.books
            _, _, current_ua = board.driver.take_pulses()
        full = current_ua[np.abs(current_ua).max(axis=1) > 600].astype(np.float64)
        own, other = ((full @ each.T).max(axis=1) for each in (rows.target, rows.other))
        assert (books.violations, books.unsafe) == (0, 0)
        assert ((own > other).all()) == (way != "reversing")
        if way == "recharging":
            assert np.abs(books.passed_uc).max() < 0.02
            assert 0 < max(answers) < 0.5
        ratio = other / np.maximum(own, 1e-9)
        row(
            "Charge by the emulator's books, two seconds of letters",
            {
                "mode": f"{mode.value}, {scan}",
                "balance": way,
                "scans": tally.frames,
                "slots": books.slots,
                "scans a second (lowest)": (
                    f"{tally.frames / tally.seconds:.1f} ({tally.lowest_rate_hz:.1f})"
                ),
                "net charge at worst, µC": f"{np.abs(books.passed_uc).max():.4f}",
                "slots that drive the class most": f"{np.mean(own > other):.0%}",
                "other at worst (median)": f"{np.max(ratio):.2f} ({np.median(ratio):.2f})",
                "recharge phase, of what an afferent needs": f"{max(answers):.2f}",
            },
        )
