"""Gate and oracle agree on every sequence, and what was proved stays as it was.

``SMARTTOUCH_SAFETY_SEQUENCES`` says how many are asked about; for a million of them
``python -m tests.safety.agreement 1000000 --jobs 2`` prints the table as well.
"""

import os

import pytest

from .agreement import attack

SEQUENCES = int(os.environ.get("SMARTTOUCH_SAFETY_SEQUENCES", "9000"))
FIRST = 900
"""From this seed on each rule is soon the only one broken."""


@pytest.mark.timeout(60 + SEQUENCES / 100)
@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
def test_gate_and_oracle_agree():
    tally = attack(FIRST, SEQUENCES)
    print(tally.table())
    assert tally.disagreements == 0, tally.table()
    assert min(tally.accepted, tally.refused) > SEQUENCES / 5
    assert tally.missing() == []
