"""Gate and oracle agree on random sequences, and the comparison finds faulty gates.

``python -m tests.safety.agreement 1000000 --jobs 2`` compares a million sequences.
"""

import pytest

from ..support.full import WHOLE, sample
from .agreement import CRASH, STRICT, UNSAFE, Tally, attack, stream
from .gate_under_test import Answer
from .oracle import Oracle

SEQUENCES = 9000 if WHOLE else 3500
FIRST = 300
"""Seed of the first stream. From this seed on, few streams are needed until each rule has been the
only broken rule of a sequence."""


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
def test_gate_and_oracle_agree():
    tally = attack(FIRST, SEQUENCES)
    print(tally.table())
    assert not tally.faults, tally.table()
    assert min(tally.accepted, tally.refused) > SEQUENCES / 5
    assert tally.missing() == []


class Careless:
    """Gate that does not enforce the rule in ``overlooks``."""

    overlooks = None

    def __init__(self, profile):
        self._oracle = Oracle(profile)

    def ask(self, sequence, clock_ns, times=1, written=True):
        broken = self._oracle.judge(sequence, clock_ns, times, written=written)
        return Answer(set(broken) <= {self.overlooks}, limit=",".join(broken))


class Strict(Careless):
    """Gate that also refuses sequences of full intensity."""

    def ask(self, sequence, clock_ns, times=1, written=True):
        answer = super().ask(sequence, clock_ns, times, written)
        full = answer.accepted and sequence.intensity == 1
        return Answer(False, limit="full") if full else answer


class Crashing(Careless):
    """Gate that fails with a TypeError instead of refusing."""

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
    """After a disagreement, gate and oracle would count different sequences as sent."""
    tally = Tally()
    stream("line-7", 0, tally, Strict)
    assert tally.faults.total() == 1
