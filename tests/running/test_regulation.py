"""Measurements of the board reach the recording and the next sequence."""

import numpy as np
import pytest

from smarttouch.base.afferent import Mode
from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline, Regulator
from smarttouch.stimulation.adaptation import Adaptation
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.recharge import ChargeBalance, RechargeRules

from ..played import played


@pytest.fixture
def regulated(profile, bank, make_frame, patch):
    """Return a function that regulates frames at full intensity, with what was measured before."""

    def regulated(regulator, *volts):
        pipeline, steps = Pipeline(profile, bank, RunConfig(scan="points")), []
        pipeline.regulator = regulator
        for index, each in enumerate(volts):
            measured = []
            if each is not None:
                before = steps[-1].sequence
                measured = [(before, np.full(before.slots, each, np.float32))]
            frame = make_frame(patch(), 1_000_000_000 * index)
            steps.append(pipeline.process(frame, allowed=1.0, observed=measured))
        return steps

    return regulated


def test_what_was_measured_is_kept_and_changes_what_is_sent(profile, regulated):
    steps = regulated(Regulator(Adaptation(profile, "energy", 300.0)), None, 50, 100)
    assert [len(step.observed) for step in steps] == [0, 1, 1]
    assert steps[2].observed[0][0] is steps[1].sequence
    peaks = [np.abs(step.sequence.current_ua.astype(int)).max() for step in steps]
    # Twice the impedance: less by its square root.
    assert peaks[2] == pytest.approx(peaks[1] / np.sqrt(2), rel=0.01)


def test_what_could_not_be_held_is_reported(profile, regulated):
    """This profile's pulses are at their limit: there is no room to lengthen them."""
    regulator = Regulator(Adaptation(profile, "charge", 100.0))
    assert Regulator().notes() == regulator.notes() == []
    step = regulated(regulator, None, *[100] * 20)[-1]
    (note,) = regulator.notes()
    assert f"{len(set(step.sequence.site))} sites" in note


def rules_of(profile):
    return RechargeRules.of(profile, ScanTiming())


def test_charge_that_cannot_be_taken_back_at_once_is_noted(profile, regulated):
    regulator = Regulator(ledger=ChargeBalance(64), recharge=rules_of(profile))
    regulator.ledger.charge_pc[:2] = [9_000_000, -9_000_000]
    regulated(regulator, None)
    assert any(f"{regulator.ledger.worst_uc:.2f} µC" in each for each in regulator.notes())


def test_reversed_scans_are_noted_with_what_they_do(regulated):
    regulator = Regulator(ledger=ChargeBalance(64))
    regulated(regulator, *[None] * 4)
    (note,) = regulator.notes()
    assert "2 of 4 scans" in note
    assert all(name in note for name in ("SAI", "RA"))


@pytest.mark.parametrize(
    ("mode", "left_uc"),
    # Some scans of PC would need more than the largest phase: the next ones take the rest back.
    [(Mode.RA, 0.02), (Mode.SAI, 0.02), (Mode.NATURAL, 0.02), (Mode.PC, 2.0)],
)
def test_by_the_emulators_books_charge_is_back_and_the_same_is_felt(
    profile, bank, make_frame, patch, mode, left_uc
):
    """A bar that moves for a second: without balance, and with each way of it."""
    ways = {
        "without": Regulator(),
        "reversing": Regulator(ledger=ChargeBalance(64)),
        "recharging": Regulator(ledger=ChargeBalance(64), recharge=rules_of(profile)),
    }
    passed_uc, pulses = {}, {}
    for way, regulator in ways.items():
        pipeline = Pipeline(profile, bank, RunConfig(mode=mode, scan="points"))
        pipeline.regulator = regulator
        with played(profile, SimulatedDriver) as board:
            for index in range(40):
                # Slow enough for every way, so that all get the same frames.
                made = pipeline.process(make_frame(patch(index, index + 9), index * 60_000_000))
                board.send(made.sequence)
            books = board.driver._firmware.books
            passed_uc[way], pulses[way] = np.abs(books.passed_uc), board.driver.take_pulses()
            assert (books.violations, books.unsafe) == (0, 0)
            assert books.max_net_charge_uc < 1e-3
            assert (books.recharges > 20) == (way == "recharging")
    assert passed_uc["recharging"].max() < left_uc < 5 < passed_uc["without"].max()
    for was, now in zip(pulses["without"], pulses["recharging"], strict=True):
        assert np.array_equal(was, now), "the slots, and so what is felt, are the same"
    turned = (pulses["reversing"][2] != pulses["without"][2]).any(axis=1)
    assert 0.2 < turned.mean() < 0.8, "which reversing cannot say of itself"
