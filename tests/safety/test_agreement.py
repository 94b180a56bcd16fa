"""Gate and oracle agree on every sequence; the attack finds every gap, and is always the same.

For a million of them ``python -m tests.safety.agreement 1000000 --jobs 2`` prints the table.
"""

import pytest

from ..support.full import sample
from .agreement import RunStatistics, attack, stream
from .gates import Answer
from .oracle import Oracle
from .quick import judge_alone_quickly

SEQUENCES = 9000
FIRST = 900
"""From this seed on each rule is soon the only one broken."""


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
def test_gate_and_oracle_agree():
    tally = attack(FIRST, SEQUENCES)
    print(tally.table())
    assert tally.disagreements == 0, tally.table()
    assert min(tally.accepted, tally.refused) > SEQUENCES / 5
    assert tally.missing() == []


class Careless:
    """A gate that overlooks one rule, and by default none; it counts what it overlooked as sent."""

    overlooks = None

    def __init__(self, profile):
        self._oracle = Oracle(profile, judge_alone_quickly)

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


@pytest.fixture(scope="module")
def tally():
    """Of so many that most limits are reached; all are by the more that the gate is asked of."""
    return attack(FIRST, 2000, Careless)


def test_it_reaches_limits_and_agrees_with_a_gate_that_overlooks_none(tally):
    assert tally.disagreements == 0
    assert len(tally.missing()) < 7
    assert min(tally.accepted, tally.refused) > 400


@pytest.mark.parametrize(("rule", "first"), sample([
    ("discharge", 0), ("time", 500), ("strong in a second", 24), ("session time", 0),
]))  # fmt: skip
def test_it_finds_what_a_gate_overlooks(rule, first):
    careless = type("Overlooks", (Careless,), {"overlooks": rule})
    assert set(attack(first, 500, careless).unsafe) == {(rule,)}


def test_it_finds_what_a_gate_refuses_without_need():
    assert set(attack(0, 500, Strict).strict) == {"full"}


def test_it_finds_what_breaks_a_gate():
    assert set(attack(0, 500, Crashing).crashes) == {"TypeError"}


def test_a_stream_ends_where_they_disagree():
    """From there on they would speak of different pasts."""
    tally = RunStatistics()
    stream("line-7", 0, tally, Strict)
    assert tally.disagreements == 1
