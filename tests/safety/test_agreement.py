"""Gate and oracle agree on every sequence; the attack finds every gap, and is always the same.

For a million of them ``python -m tests.safety.agreement 1000000 --jobs 2`` prints the table.
"""

import pytest

from ..support.full import WHOLE, sample
from .agreement import CRASH, STRICT, UNSAFE, Tally, attack, stream
from .gates import Answer
from .oracle import Oracle

SEQUENCES = 9000 if WHOLE else 3500
FIRST = 300
"""From this seed on each rule is soon the only one broken."""


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
def test_gate_and_oracle_agree():
    tally = attack(FIRST, SEQUENCES)
    print(tally.table())
    assert not tally.faults, tally.table()
    assert min(tally.accepted, tally.refused) > SEQUENCES / 5
    assert tally.missing() == []


class Careless:
    """A gate that overlooks one rule; it counts what it overlooked as sent."""

    overlooks = None

    def __init__(self, profile):
        self._oracle = Oracle(profile)

    def ask(self, sequence, clock_ns, times=1, written=True):
        broken = self._oracle.judge(sequence, clock_ns, times, written=written)
        return Answer(set(broken) <= {self.overlooks}, limit=",".join(broken))


class Strict(Careless):
    """A gate that refuses what is full."""

    def ask(self, sequence, clock_ns, times=1, written=True):
        answer = super().ask(sequence, clock_ns, times, written)
        full = answer.accepted and sequence.intensity == 1
        return Answer(False, limit="full") if full else answer


class Crashing(Careless):
    """A gate that falls over what it refuses."""

    def ask(self, sequence, clock_ns, times=1, written=True):
        answer = super().ask(sequence, clock_ns, times, written)
        return answer if answer.accepted else Answer(False, crash="TypeError")


@pytest.mark.parametrize(("rule", "first"), sample([
    ("discharge", 48), ("time", 24), ("strong in a second", 24), ("session time", 0),
]))  # fmt: skip
def test_it_finds_what_a_gate_overlooks(rule, first):
    careless = type("Overlooks", (Careless,), {"overlooks": rule})
    assert set(attack(first, 500, careless).faults) == {(UNSAFE, rule)}


@pytest.mark.parametrize(("kind", "fault"), [
    (Strict, (STRICT, "full")), (Crashing, (CRASH, "TypeError")),
])  # fmt: skip
def test_it_finds_what_a_gate_refuses_without_need_or_by_an_error(kind, fault):
    assert set(attack(0, 500, kind).faults) == {fault}


def test_a_stream_ends_where_they_disagree():
    """From there on they would speak of different pasts."""
    tally = Tally()
    stream("line-7", 0, tally, Strict)
    assert tally.faults.total() == 1
