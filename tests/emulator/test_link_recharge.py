"""The emulated board's recharge phase: executed, counted, cut off, and refused."""

import numpy as np
import pytest

from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.protocol import Feature, MessageKind, Refusal, Rule
from smarttouch.emulator.firmware import RECHARGE, DeliveryLog, read_recharges, read_slots
from smarttouch.emulator.skin import Delivered

from .rig import LinkRig

SLOTS = [[300, -100, -100, -100], [-100, 300, -100, -100]]
"""Two pulses of 100 µs, 50 µs apart: 20, 20, −20 and −20 nC."""
BACK = [-20, -20, 20, 20]
"""In 1,000 µs."""


class Rig(LinkRig):
    def send(self, now_ms, recharge=BACK, recharge_us=1000, *, slots=SLOTS, **more):
        slots = np.reshape(slots, (-1, 4))
        return super().send(
            now_ms, slots, recharge=np.int16(recharge), recharge_us=recharge_us, **more
        )


@pytest.fixture
def rig():
    return Rig()


@pytest.mark.parametrize("output", ["weighted", "three-state", "one-against-all"])
def test_only_a_board_with_a_source_for_each_electrode_offers_it(output):
    features = protocol.CAPABILITIES.unpack_from(Rig(output=output).can.payload)[2]
    assert bool(features & Feature.RECHARGE) == (output == "weighted")


def test_it_takes_back_what_the_slots_have_passed(tmp_path):
    rig = Rig(folder=tmp_path)
    assert rig.send(0)[0].kind == MessageKind.ACK
    rig.advance(5)
    np.testing.assert_allclose(rig.books.passed_uc, [0.02, 0.02, -0.02, -0.02])
    rig.advance(10)
    np.testing.assert_allclose(rig.books.passed_uc, 0, atol=1e-12)
    assert (rig.books.slots, rig.books.pulses, rig.books.recharges) == (2, 8, 1)
    assert (rig.books.violations, rig.books.unsafe) == (0, 0)
    assert rig.books.max_charge_uc == pytest.approx(0.03)
    assert rig.books.max_net_charge_uc < 1e-3
    rig.books.write()
    (phase,) = read_recharges(tmp_path)
    assert (phase["number"], phase["time_us"]) == (1, 300)
    assert phase["current_ua"].tolist() == BACK
    slots = read_slots(tmp_path)
    assert (slots["slot"].tolist(), slots["current_ua"].tolist()) == ([0, 1], SLOTS)


@pytest.mark.parametrize(("at_ms", "share"), [(0.2, 0), (0.3, 0), (0.55, 0.25), (1.3, 1), (9, 1)])
def test_a_stop_cuts_it_off(rig, at_ms, share):
    rig.send(0)
    rig.say(at_ms, MessageKind.STOP)
    rig.advance(50)
    left_uc = 0.02 * (1 - share)
    np.testing.assert_allclose(rig.books.passed_uc, np.multiply([1, 1, -1, -1], left_uc), atol=1e-9)
    assert rig.books.recharges == (share > 0)
    assert (rig.books.state, rig.books.reason) == ("shorted", "stop")


def test_silence_cuts_it_off_at_its_own_time():
    slow = [-2, -2, 2, 2]
    rig = Rig()
    rig.send(0, slow, 10_000, period=400_000, slots=SLOTS * 640)
    rig.advance(150)
    # 1,280 slots take 192 ms: the host was lost before.
    assert (rig.books.recharges, rig.books.reason) == (0, "silence")
    rig = Rig()
    rig.send(0, slow, 20_000, period=400_000, slots=SLOTS * 300)
    rig.advance(300)
    # The phase began after 90 ms, and silence was noticed after 100.
    assert (rig.books.recharges, rig.books.reason) == (1, "silence")
    assert rig.books.passed_uc[0] == pytest.approx(300 * 0.02 - 2e-6 * 10_000)


FAR = {"recharge_us": 20_000, "period": 50_000}


@pytest.mark.parametrize(("bad", "good", "rule"), [
    ({"recharge": [-20, -20, 20, 19]}, {"recharge": [-20, -20, 20, 20]}, Rule.BALANCE),
    ({"recharge": [-501, 501, 0, 0]}, {"recharge": [-500, 500, 0, 0]}, Rule.CURRENT),
    ({"recharge": [-32768, 32767, 1, 0]}, {"recharge": [-500, 499, 1, 0]}, Rule.CURRENT),
    ({"recharge_us": 0}, {"recharge_us": 1}, Rule.RECHARGE),
    (FAR | {"recharge_us": 20_001}, FAR, Rule.RECHARGE),
    ({"recharge": [-500, 0, 500, 0], "recharge_us": 4001},
     {"recharge": [-500, 0, 500, 0], "recharge_us": 4000}, Rule.CURRENT),
    ({"recharge_us": 15_700, "period": 16_019}, {"recharge_us": 12_600, "period": 16_020},
     Rule.FIT),
    ({"recharge_us": 7_801}, {"recharge_us": 7_800}, Rule.DUTY),
    ({"slots": []}, {}, Rule.RECHARGE),
    ({"recharge": [-20, 20, 0, 0, 0]}, {"recharge": [-20, 20, 0, 0]}, Rule.NONE),
    # More is taken back than the largest phase brings, to a larger charge than before.
    (FAR | {"recharge": [100, 0, -100, 0]}, FAR | {"recharge": [-100, 0, 100, 0]}, Rule.RECHARGE),
])  # fmt: skip
def test_what_breaks_the_boards_own_limits_is_refused(bad, good, rule):
    """By itself: what keeps the limit by one is taken."""
    (answer,) = Rig().send(0, **good)
    assert answer.kind == MessageKind.ACK
    rig = Rig()
    (answer,) = rig.send(0, **bad)
    refusal = Refusal.UNSAFE if rule else Refusal.MALFORMED
    assert protocol.NAK.unpack(answer.payload)[:2] == (refusal, rule)
    rig.advance(50)
    assert (rig.books.slots, rig.books.recharges, rig.books.violations) == (0, 0, 1)


@pytest.mark.parametrize(("current_ua", "width_us", "unsafe"), [
    (500, 4000, 0), (501, 10, 1), (100, 20_001, 1), (500, 4001, 1),
])  # fmt: skip
def test_the_books_look_for_themselves(current_ua, width_us, unsafe):
    books, current = DeliveryLog(2), np.array([current_ua, -current_ua], float)
    delivered = Delivered(current, current * width_us, current, 0.0)
    books.enter(1, RECHARGE, RECHARGE, delivered, width_us, current * 0, 0.0)
    assert books.unsafe == unsafe
