"""Comparison of safety gate and oracle: ``python -m tests.safety.agreement 1000000``.

Run it in the repository's root; ``--jobs 2`` uses two processes. Gate and oracle judge the same
random sequences. The exit status is 1 if they disagree, or if some rule was never broken alone.
"""

import argparse
import random
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

from .attacked_profiles import display, display_names
from .bounds import LATE_NS
from .drafts import later, opening, ordinary
from .edges import EDGES, attacks
from .garbage import garbled
from .gate_under_test import GateUnderTest, faults_of_copy
from .oracle import NAMES, Oracle

STREAM = 80
"""Number of random sequences for one gate."""
WRITTEN = 0.95
"""Share of sequences that are written to the board before a newer sequence replaces them."""
HURRIES = (
    "sequences in a second", "strong in a second", "mean in a second", "mean in a second",
    "net in a second", "reduces charge", "session time", "session charge",
)  # fmt: skip
"""In half of the streams, most sequences try to break one of these rules, in quick succession."""
UNSAFE, STRICT, CRASH, COPY = (
    "accepted only by the gate", "refused only by the gate", "unexpected error of the gate",
    "wrong or writable field in the gate's copy",
)  # fmt: skip


@dataclass
class Tally:
    """Counts of sequences, broken rules and disagreements."""

    accepted: int = 0
    refused: int = 0
    broken: Counter = field(default_factory=Counter)
    only: Counter = field(default_factory=Counter)
    """For each rule, the number of sequences that broke it and no other rule."""
    faults: Counter = field(default_factory=Counter)
    """Number of disagreements, by kind and detail (rules, limit, error or field)."""
    first: dict = field(default_factory=dict)
    """Display, seed, index and attack of the first sequence with each fault."""

    @property
    def asked(self):
        return self.accepted + self.refused

    def missing(self):
        """Return the rules that were never the only broken rule of a sequence."""
        return sorted(set(NAMES) - set(self.only))

    def note(self, broken, answer, sequence, where):
        """Count a sequence: the rules that the oracle found broken, and the gate's answer."""
        self.accepted += answer.accepted
        self.refused += not answer.accepted
        self.broken.update(broken)
        self.only.update(broken if len(broken) == 1 else ())
        faults = []
        if answer.copy is not None:
            faults += [(COPY, name) for name in faults_of_copy(answer.copy, sequence)]
        if answer.crash:
            faults.append((CRASH, answer.crash))
        if answer.accepted and broken:
            faults.append((UNSAFE, ", ".join(broken)))
        elif not answer.accepted and not broken:
            faults.append((STRICT, answer.limit))
        for fault in faults:
            self.faults[fault] += 1
            self.first.setdefault(fault, where)

    def add(self, other):
        """Add the counts of another process."""
        self.accepted += other.accepted
        self.refused += other.refused
        for name in ("broken", "only", "faults"):
            getattr(self, name).update(getattr(other, name))
        self.first = other.first | self.first

    def table(self):
        """Return the counts as a text table."""
        lines = [f"{self.asked} sequences: {self.accepted} accepted, {self.refused} refused"]
        lines.append(f"{'rule':22}{'broken':>10}{'only this':>10}")
        lines += [f"{name:22}{self.broken[name]:10}{self.only[name]:10}" for name in NAMES]
        for (kind, what), count in self.faults.most_common(30):
            lines.append(f"{count} x {kind}: {what}, first at {self.first[kind, what]}")
        lines.append(f"{self.faults.total()} disagreements; never broken alone: {self.missing()}")
        return "\n".join(lines)


def drawn(oracle, rng, clock_ns, time_ns, attack=None):
    """Draw a draft; return the draft, its sequence and its kind: "ordinary", "garbage", or the
    name of the attacked limit. Without ``attack``, the kind is random.
    """
    draft = ordinary(oracle, rng, clock_ns, time_ns, full=attack is not None)
    chance = 1.0 if attack else rng.random()
    if chance < 0.3:
        return draft, draft.made(), "ordinary"
    if chance < 0.45:
        return draft, garbled(draft, rng), "garbage"
    attack = attack or rng.choice(attacks(oracle.bounds))
    EDGES[attack](draft, oracle, rng, rng.choice((-1, 0, 1)))
    return draft, draft.made(), attack


def stream(name, seed, tally, make_gate=GateUnderTest, count=STREAM):
    """Send a stream of sequences to one gate of a display, until gate and oracle disagree."""
    rng = random.Random(f"{name} {seed}")
    profile = display(name)
    oracle, gate = Oracle(profile), make_gate(profile)
    clock_ns, time_ns = rng.choice((0, 10**9, 2**61)), rng.choice((0, 10**9, 2**61))
    hurry = rng.random() < 0.5 and rng.choice(HURRIES)
    opens = rng.random() < 0.9
    if hurry == "sequences in a second":
        count += oracle.bounds.most_passes
    for index in range(count):
        # Limit the number of tries, because other limits may forbid sequences that raise the ramp.
        for _ in range(2 + oracle.bounds.ramp_ns // LATE_NS if index == 1 and opens else 0):
            draft = opening(oracle, clock_ns + 1, time_ns + 1)
            if not question(gate, oracle, draft, draft.made(), tally, (name, seed, 1, "opening")):
                return
            clock_ns, time_ns = clock_ns + LATE_NS, time_ns + LATE_NS
        if index == 1:
            clock_ns, time_ns = clock_ns + LATE_NS, time_ns + LATE_NS
        elif hurry and index > 1:
            step_ns = rng.choice((10**5, 10**6, 2 * 10**6, 10**7))
            clock_ns, time_ns = clock_ns + step_ns, time_ns + step_ns
        else:
            further_ns, claimed_ns = later(oracle, rng)
            clock_ns, time_ns = max(0, clock_ns + further_ns), time_ns + claimed_ns
        chosen = hurry if hurry and index > 1 and rng.random() < 0.9 else None
        draft, sequence, attack = drawn(oracle, rng, clock_ns, time_ns, chosen)
        where = name, seed, index, attack
        written = index == 0 or rng.random() < WRITTEN
        if not question(gate, oracle, draft, sequence, tally, where, written):
            return


def question(gate, oracle, draft, sequence, tally, where, written=True):
    """Let oracle and gate judge a sequence; return whether they agree."""
    broken = oracle.judge(sequence, draft.clock_ns, draft.times, written=written)
    answer = gate.ask(sequence, draft.clock_ns, draft.times, written)
    tally.note(broken, answer, sequence, where)
    return answer.accepted == (not broken)


def attack(first_seed, count, make_gate=GateUnderTest):
    """Send at least ``count`` sequences to the gates of all displays in turn; return the tally."""
    tally, seed = Tally(), first_seed
    names = display_names()
    while tally.asked < count:
        stream(names[seed % len(names)], seed // len(names), tally, make_gate)
        seed += 1
    return tally


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.safety.agreement", description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=10_000)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0, help="seed of the first stream")
    options = parser.parse_args()
    started, tally = time.perf_counter(), Tally()
    share = -(-options.count // options.jobs)
    with ProcessPoolExecutor(options.jobs) as pool:
        seeds = [options.seed + 10**9 * job for job in range(options.jobs)]
        for part in pool.map(attack, seeds, [share] * options.jobs):
            tally.add(part)
    print(tally.table())
    print(f"{time.perf_counter() - started:.0f} s")
    sys.exit(bool(tally.faults or tally.missing()))


if __name__ == "__main__":
    main()
