"""Tests that ``simulated:`` and ``emulator:`` deliver the same pulses."""

from functools import partial

import numpy as np
import pytest

import smarttouch as st
from smarttouch.boards.board import Board
from smarttouch.emulator.firmware_base import read_slots, read_state

from ..support.full import sample

pytestmark = pytest.mark.realtime

FIGURES = (
    "frames", "sequences", "slots", "pulses", "acknowledged", "refused", "dropped_late", "restarts",
    "lifts", "without_force_or_image", "packets_refused_by_board", "reported_by",
)  # fmt: skip
BOOKS = (
    "sequences", "slots", "pulses", "violations", "unsafe", "recharges", "passed_uc",
    "max_current_ma", "max_charge_uc", "max_volts",
)  # fmt: skip


class Kept(st.Listener):
    """Listener that stores sequences and forces by number, and measured voltages by time."""

    def __init__(self):
        super().__init__()
        self.sent, self.force_n, self.volts, self.shared = {}, {}, {}, 0

    def step(self, result):
        sequence = result.step.sequence
        self.sent[result.number] = sequence.time_ns, sequence.intensity, sequence.period_us
        self.force_n[result.number] = result.step.input.force_n
        self.shared += sequence.proof is not None and int((sequence.proof.points > 1).sum())
        for sequence, volts in result.step.observed:
            self.volts[sequence.time_ns] = volts.tolist()


@pytest.mark.parametrize(("name", "mode", "scan", "balance"), sample([
    ("electric-mouse", "natural", "auto", False), ("electric-mouse", "RA", "points", True),
    ("smarttouch-4x4", "RA", "auto", False),
]))  # fmt: skip
def test_a_run_is_the_same_on_both(name, mode, scan, balance, tmp_path, monkeypatch):
    # On both boards, the ramp uses the times stated in sequences, not the computer's clock.
    monkeypatch.setattr("smarttouch.boards.open.Board", partial(Board, claimed_time=True))
    profile = st.load_profile(name)

    def run_on(url, **options):
        source = st.open_source("text:no?speed_mm_s=25", profile)
        display, kept = st.open_display(url, profile, **options), Kept()
        statistics = st.run(
            source, display, mode=mode, scan=scan, balance=balance, seed=1, intensity=1.0,
            listeners=[kept],
        )  # fmt: skip
        return display.board, kept, {name: statistics.figures[name] for name in FIGURES}

    board, kept, figures = run_on("simulated:")
    for attempt in range(3):
        (books := tmp_path / str(attempt)).mkdir()
        other, its, its_figures = run_on("emulator:", books=books)
        # Repeat the run if figures differ, as they may on a busy computer.
        if its_figures == figures:
            break
    assert (figures, kept.sent, kept.force_n) == (its_figures, its.sent, its.force_n)
    assert board.capabilities == other.capabilities
    # The board ``emulator:`` sends voltages late, so the last ones arrive after the last step.
    assert set(kept.volts) >= set(its.volts)
    assert [kept.volts[time_ns] for time_ns in its.volts] == list(its.volts.values())
    assert len(its.volts) > 10
    (number, width_us, current_ua), slots = board.driver.take_pulses(), read_slots(books)
    assert len(number) > 50
    np.testing.assert_array_equal(number, slots["number"])
    np.testing.assert_array_equal(current_ua, slots["current_ua"])
    peak_ua = np.abs(current_ua.astype(int)).max(axis=1)
    peak_uc = np.abs(slots["charge_uc"]).max(axis=1)
    np.testing.assert_allclose(width_us, 1e6 * peak_uc / peak_ua, rtol=1e-6)
    expected, state = vars(board.driver._firmware.books), read_state(books)
    assert {name: state[name] for name in BOOKS} == {
        name: pytest.approx(expected[name]) for name in BOOKS
    }
    assert (kept.shared > 50) == (profile.output.kind == "weighted" and scan == "auto")
    assert (state["recharges"] > 10) == balance
