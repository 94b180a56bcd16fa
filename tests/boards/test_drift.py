"""An electrode's impedance drifts while a board runs: what was measured keeps the charge.

The board is in this thread and its time passes as it is sent to: nothing depends on the machine.
``SMARTTOUCH_DRIFT_SECONDS=60 pytest tests/boards/test_drift.py --timeout 0 -s`` for the figures.
"""

import functools
import os
from collections import deque

import numpy as np
import pytest

from smarttouch.boards.link.protocol import MessageKind, decode_volts
from smarttouch.boards.probe_scans import one_each
from smarttouch.emulator.finger_events import EmulatedFinger
from smarttouch.emulator.firmware import read_slots
from smarttouch.emulator.skin import COMPLIANCE_V
from smarttouch.profile import load_profile
from smarttouch.stimulation.adaptation import Adaptation
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from tests.boards.payloads import sequence_payload
from tests.emulator.rig import LinkRig
from tests.scans import adapted

SECONDS = float(os.environ.get("SMARTTOUCH_DRIFT_SECONDS", "1.2"))
DRIFTING, STEADY = 6, 9
LEVEL_MA, WIDTH_US, PERIOD_S = 2.2, 100, 0.02
LATE = 2
"""Sequences that have been sent before the voltages of one are back: one runs, one waits."""


class ToldLink(LinkRig):
    """A link board that measures, one thread with its host: a sequence takes the time it says."""

    def __init__(self, limits, kind, folder, events):
        finger = EmulatedFinger(limits.electrodes, events)
        super().__init__(limits.electrodes, kind, folder=folder, finger=finger)
        self.gate, self.now_ms, self.number = SafetyGate(limits), 0, 0

    def deliver(self, sequence):
        """Deliver a sequence; return what each of its slots needed, V."""
        sequence = self.gate.check(sequence)
        self.number += 1
        payload = sequence_payload(
            self.output, sequence.period_us, sequence.width_us, sequence.discharge_us,
            sequence.site, sequence.current_ua, measure=True,
        )  # fmt: skip
        heard = self.say(self.now_ms, MessageKind.SEQUENCE, self.number, payload)
        self.now_ms += sequence.period_us / 1000
        heard += self.advance(self.now_ms)
        assert [each.kind for each in heard if each.kind in (MessageKind.ACK, MessageKind.NAK)] == [
            MessageKind.ACK
        ]
        (volts,) = (each.payload for each in heard if each.kind == MessageKind.VOLTAGES)
        return decode_volts(volts)


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
    folder = tmp_path_factory.mktemp("books")
    board = ToldLink(limits, kind, folder, [f"1 drift {DRIFTING} 4 {SECONDS}"])
    adaptation = None if hold is None else Adaptation(profile, hold, COMPLIANCE_V)
    measured = deque()
    for step in range(int((SECONDS + 1) / PERIOD_S)):
        part = min(1.0, step / 40)
        sequence = one_each(
            limits, round(1000 * LEVEL_MA * part), WIDTH_US, part * LEVEL_MA / limits.full_ma,
            step * int(PERIOD_S * 1e9), cathodic=False, sites=[DRIFTING, STEADY],
            period_us=int(PERIOD_S * 1e6),
        )  # fmt: skip
        if adaptation is not None:
            if len(measured) > LATE:
                adaptation.observe(*measured.popleft())
            sequence = adapted(adaptation, sequence)
        measured.append((sequence, board.deliver(sequence)))
    assert board.books.violations == 0
    board.books.write()
    watch.judge_books(folder, profile, period_us=int(PERIOD_S * 1e6))
    slots = read_slots(folder)
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
