"""The emulator's account: of what flowed, whatever was asked for."""

import numpy as np
import pytest

from smarttouch.emulator.firmware import RECHARGE, DeliveryLog, read_slots, read_state
from smarttouch.emulator.skin import Delivered


def enter(books, current_ua, width_us=100, residual_uc=0.0, **other):
    current = np.array(current_ua, np.float64)
    delivered = Delivered(current, current * width_us, current / 50, float(np.ptp(current) / 50))
    books.enter(7, 2, 1, delivered, width_us, current * 0 + residual_uc, 1234.6, **other)
    return books


def test_what_is_read_is_what_was_entered(tmp_path):
    books = DeliveryLog(3, tmp_path)
    enter(books, [300.4, -100, -200.4], residual_uc=-0.001)
    books.write()
    enter(books, [40_000, -20_000, -20_000])
    books.write()
    slots = read_slots(tmp_path)
    assert slots["number"].tolist() == [7, 7]
    assert (slots["slot"][0], slots["site"][0], slots["time_us"][0]) == (2, 1, 1234)
    assert slots["current_ua"].tolist() == [[300, -100, -200], [40_000, -20_000, -20_000]]
    np.testing.assert_allclose(slots["volts"][0], [6, -2, -4], rtol=0.01)
    np.testing.assert_allclose(slots["residual_uc"][0], -0.001, rtol=0.001)
    state = read_state(tmp_path)
    assert (state["slots"], state["pulses"], state["unsafe"]) == (2, 6, 1)
    assert state["max_volts"] == pytest.approx(1200)


@pytest.mark.parametrize(("current_ua", "width_us", "unsafe"), [
    (5000, 100, 0), (5000.004, 100, 0), (5001, 50, 1), (-5001, 50, 1), (5000, 101, 1),
    (100, 200, 0), (100, 201, 1), (2500, 200, 0), (2501, 200, 1), (0, 60_000, 0),
])  # fmt: skip
def test_unsafe_is_what_flowed_above_a_safe_value(current_ua, width_us, unsafe):
    assert enter(DeliveryLog(2), [current_ua, -current_ua], width_us).unsafe == unsafe


@pytest.mark.parametrize(("current_ua", "width_us", "unsafe"), [
    (500, 4000, 0), (501, 10, 1), (100, 20_001, 1), (500, 4001, 1),
])  # fmt: skip
def test_a_recharge_phase_has_its_own_safe_values(current_ua, width_us, unsafe):
    books, current = DeliveryLog(2), np.array([current_ua, -current_ua], float)
    delivered = Delivered(current, current * width_us, current, 0.0)
    books.enter(1, RECHARGE, RECHARGE, delivered, width_us, current * 0, 0.0)
    assert (books.unsafe, books.recharges, books.slots) == (unsafe, 1, 0)


def test_two_pulses_of_a_slot_count_as_one_slot():
    books = DeliveryLog(2)
    enter(books, [100, -100], residual_uc=0.5, more=True)
    enter(books, [-100, 100], residual_uc=0.25)
    assert (books.slots, books.pulses, books.max_net_charge_uc) == (1, 4, 0.25)


def test_what_rounds_to_nothing_is_no_pulse():
    assert enter(DeliveryLog(3), [0.4, -0.4, 0]).pulses == 0
