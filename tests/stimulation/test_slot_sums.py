"""Sums over slots: exact, whatever the numbers and however many blocks they take."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.stimulation import slot_sums as module
from smarttouch.stimulation.slot_sums import PER_PC, PER_PULSE, SlotAdder


def check(current_ua, width_us, felt_ua):
    """Compare with sums of whole numbers."""
    found = SlotAdder(felt_ua).add_up(current_ua, width_us)
    wide = current_ua.astype(np.int64)
    magnitude = np.abs(wide)
    assert found.net_ua.tolist() == wide.sum(axis=1).tolist()
    assert found.total_ua.tolist() == magnitude.sum(axis=1).tolist()
    assert found.highest_ua == magnitude.max()
    felt = (magnitude >= felt_ua.astype(np.int64)).sum(axis=0)
    assert found.sums[0].tolist() == (PER_PULSE * felt).tolist()
    charge_pc = (magnitude * width_us.astype(np.int64)[:, None]).sum(axis=0)
    assert found.sums[1].tolist() == (PER_PC * charge_pc).tolist()


@given(
    slots=st.integers(1, 40),
    electrodes=st.integers(1, 70),
    block=st.sampled_from([1, 64, 300, 65_536]),
    most_ua=st.sampled_from([1, 5000, 32_767]),
    one_width=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_sums_are_those_of_whole_numbers(slots, electrodes, block, most_ua, one_width, seed):
    random = np.random.default_rng(seed)
    current_ua = random.integers(-most_ua - 1, most_ua + 1, (slots, electrodes)).astype(np.int16)
    width_us = random.integers(1, 2**16, slots).astype(np.uint16)
    if one_width:
        width_us[:] = width_us[0]
    felt_ua = random.integers(0, most_ua + 2, electrodes).astype(np.float32)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "BLOCK", block)
        check(current_ua, width_us, felt_ua)
