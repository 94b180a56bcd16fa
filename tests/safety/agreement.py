"""Gate and oracle on the same sequences: ``python -m tests.safety.agreement 1000000``.

Run in the repository's root; ``--jobs 2`` divides the work among processes. It prints a table
and ends with 1 if the two disagree anywhere, or a limit was never the only one broken.
"""

import argparse
import random
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

from .bounds import LATE_NS
from .displays import display, display_names
from .drafts import later, opening, ordinary
from .edges import EDGES, attacks
from .garbage import garbled
from .gates import GateUnderTest, faults_of_copy
from .oracle import NAMES, Oracle
from .quick import judge_alone_quickly
from .rules import judge_alone

STREAM = 80
"""Sequences to one gate."""
PLAIN_EVERY = 20
"""One stream of so many is judged by the plain form of the rules, if its array is small."""
SMALL = 20
WRITTEN = 0.95
"""Part of the sequences that are written; others are replaced by newer ones."""
HURRIES = (
    "sequences in a second", "strong in a second", "mean in a second", "mean in a second",
    "net in a second", "takes back", "session time", "session charge",
)  # fmt: skip
"""Limits over time at whose edge half of the streams stay, one sequence after another."""


@dataclass
class RunStatistics:
    """Results of many questions."""

    accepted: int = 0
    refused: int = 0
    only: Counter = field(default_factory=Counter)
    """How often each rule was the only one broken."""
    broken: Counter = field(default_factory=Counter)
    unsafe: Counter = field(default_factory=Counter)
    """What the gate accepted and the oracle does not, by the rules that it breaks."""
    strict: Counter = field(default_factory=Counter)
    """What the gate refused and the oracle does not, by the limit that the gate names."""
    crashes: Counter = field(default_factory=Counter)
    """Errors of a gate that are not its own."""
    copies: Counter = field(default_factory=Counter)
    """Faults of the copies that a gate returned."""
    examples: dict = field(default_factory=dict)

    @property
    def asked(self):
        return self.accepted + self.refused

    @property
    def over_time(self):
        """Number of sequences that a limit over a second or a session refused, and no other."""
        return sum(self.only[name] for name in set(HURRIES))

    @property
    def disagreements(self):
        return sum(map(Counter.total, (self.unsafe, self.strict, self.crashes, self.copies)))

    def missing(self):
        """Return the rules that were never the only one broken."""
        return sorted(set(NAMES) - set(self.only))

    def add(self, other):
        """Add up with that of another process."""
        self.accepted += other.accepted
        self.refused += other.refused
        for name in ("only", "broken", "unsafe", "strict", "crashes", "copies"):
            getattr(self, name).update(getattr(other, name))
        self.examples = other.examples | self.examples

    def table(self):
        """Return it for people."""
        lines = [f"{self.asked} asked, {self.accepted} accepted, {self.refused} refused"]
        lines.append(f"{'rule':22}{'broken':>10}{'alone':>10}{'let through':>13}")
        let_through = Counter()
        for rules, count in self.unsafe.items():
            for rule in rules:
                let_through[rule] += count
        for name in NAMES:
            lines.append(
                f"{name:22}{self.broken[name]:10}{self.only[name]:10}{let_through[name]:13}"
            )
        for title, counter in (
            ("accepted by the gate alone", self.unsafe),
            ("refused by the gate alone", self.strict),
            ("not an error of the gate's own", self.crashes),
            ("faults of copies", self.copies),
        ):
            lines += [f"{title}: {count} x {what}" for what, count in counter.most_common(30)]
        lines.append(f"ended by a limit over time: {self.over_time}")
        lines.append(f"disagreements: {self.disagreements}; never alone: {self.missing()}")
        return "\n".join(lines)


def drawn(oracle, rng, clock_ns, time_ns, attack=None):
    """Return a draft, its sequence and what it is: ordinary, garbage, or the limit at whose edge it
    is, which may be given.
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
    """Send one gate of a display a stream of sequences, until it and the oracle disagree."""
    rng = random.Random(f"{name} {seed}")
    profile = display(name)
    small = len(profile.electrodes) <= SMALL and seed % PLAIN_EVERY == 0
    oracle = Oracle(profile, judge_alone if small else judge_alone_quickly)
    gate = make_gate(profile)
    clock_ns, time_ns = rng.choice((0, 10**9, 2**61)), rng.choice((0, 10**9, 2**61))
    hurry = rng.random() < 0.5 and rng.choice(HURRIES)
    opens = rng.random() < 0.9
    if hurry == "sequences in a second":
        count += oracle.bounds.most_passes
    for index in range(count):
        # Bounded: an opening that some other limit forbids opens nothing, however often.
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
    """Ask both of a sequence; return whether they agree."""
    broken = oracle.judge(sequence, draft.clock_ns, draft.times, written=written)
    answer = gate.ask(sequence, draft.clock_ns, draft.times, written)
    tally.broken.update(broken)
    if len(broken) == 1:
        tally.only[broken[0]] += 1
    if answer.accepted:
        tally.accepted += 1
    else:
        tally.refused += 1
    agree = True
    if answer.crash:
        tally.crashes[answer.crash] += 1
        tally.examples.setdefault(answer.crash, where)
    if answer.accepted and broken:
        tally.unsafe[tuple(broken)] += 1
        tally.examples.setdefault(tuple(broken), where)
        agree = False
    elif not answer.accepted and not broken:
        tally.strict[answer.limit or "crash"] += 1
        tally.examples.setdefault(answer.limit or "crash", where)
        agree = False
    if answer.accepted and answer.copy is not None:
        for fault in faults_of_copy(answer.copy, sequence):
            tally.copies[fault] += 1
            tally.examples.setdefault(fault, where)
    return agree


def attack(first_seed, count, make_gate=GateUnderTest):
    """Ask so many questions, of one display after another; return what came of them."""
    tally, seed = RunStatistics(), first_seed
    names = display_names()
    while tally.asked < count:
        stream(names[seed % len(names)], seed // len(names), tally, make_gate)
        seed += 1
    return tally


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.safety.agreement", description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=10_000)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0, help="of the first stream")
    options = parser.parse_args()
    started, tally = time.perf_counter(), RunStatistics()
    each = -(-options.count // options.jobs)
    with ProcessPoolExecutor(options.jobs) as pool:
        seeds = [options.seed + 10**9 * job for job in range(options.jobs)]
        for part in pool.map(attack, seeds, [each] * options.jobs):
            tally.add(part)
    print(tally.table())
    for what, where in tally.examples.items():
        print(f"first {what}: {where}")
    print(f"{time.perf_counter() - started:.0f} s")
    sys.exit(bool(tally.disagreements or tally.missing()))


if __name__ == "__main__":
    main()
