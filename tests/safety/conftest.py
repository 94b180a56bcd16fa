"""A gate at full intensity, for tests of one limit at a time."""

import numpy as np
import pytest

from smarttouch.profile import load_profile
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

from ..support.scans import open_level
from .gates import ManualClock


@pytest.fixture
def limits():
    return SafetyLimits.of(load_profile("electric-mouse"))


@pytest.fixture
def opened(limits):
    """A gate at full intensity a second after its start, and its clock."""
    clock = ManualClock()
    gate = SafetyGate(limits, clock)
    none = np.empty(0, np.uint16)
    silent = ScanSequence(np.empty((0, 64), np.int16), none, none, none, 20_000, 1.0, 0)
    open_level(gate.check, silent, limits, clock=clock)
    return gate, clock
