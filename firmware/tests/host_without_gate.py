"""Histories of a board whose host has no gate: random scans, and scans at the edge of each rule."""

import itertools
from collections import Counter
from dataclasses import replace

import numpy as np

from firmware.tests.core_and_emulator import Talk
from firmware.tests.refusal_model import FULL, Judge, Limits, Scan
from smarttouch.boards import link as protocol
from smarttouch.boards.link import MessageKind, Refusal, Rule

ELECTRODES = 4


class Life:
    """Host without a gate, board of the C core, and a `Judge` that predicts each decision."""

    def __init__(self, core, seed, output="weighted", ramp=True):
        self.core, self.rng = core, np.random.default_rng(seed)
        self.talk, self.judge = Talk(core), Judge(ELECTRODES, ramp)
        self.switched, self.ramp = output != "weighted", ramp
        self.number, self.free_us, self.decided = 0, 0, Counter()
        self.begun, self.talk.pulses = [], []

    def begin(self, limits=None):
        """Begin a session with the limits given, or with random ones, some of which are strict."""
        if hasattr(self, "limits"):
            # End the live session first, because during a session a board refuses HELLO.
            self.judge.stop(self.talk.now_us)
            self.talk.say(MessageKind.STOP)
            self._note()
        pick = self.rng.choice
        self.limits = limits or Limits(
            period_us=int(pick([0, 5000, 8000])),
            total_ua=int(pick([1500, 12_000])),
            full_ua=int(pick([2000, 9000])),
            rounding_ua=int(pick([2, 700])),
            ramp_ms=int(pick([0, 100, 700])),
            session_s=int(pick([1, 3, 3600])),
            session_uc=int(pick([60, 4000, 9_000_000])),
            duty=int(pick([30, 80, 100])),
            current_ua=tuple(int(each) for each in pick([4000, 6000], ELECTRODES)),
            felt_ua=tuple(int(each) for each in pick([0, 100, 60_000], ELECTRODES)),
            charge_pc=tuple(int(each) for each in pick([200_000, 900_000], ELECTRODES)),
        )
        self.talk.begin()
        self.talk.say(MessageKind.LIMITS, payload=self.limits.payload())
        self.judge.begin(self.limits, self.switched)
        self.number, self.free_us = 0, self.talk.now_us
        return self

    def wait(self, time_us):
        while time_us > 0:
            step_us = min(80_000, time_us)
            self.talk.wait(step_us, step_us)
            self._note()
            self.talk.say(MessageKind.HEARTBEAT)
            time_us -= step_us

    def send(self, scan):
        """Send a scan when the board can queue it; check and return the board's decision."""
        self.wait(max(0, self.free_us - self.talk.now_us))
        now_us = self.talk.now_us
        wanted = self.judge.refusal(scan, now_us)
        start_us = self.judge.start_us(now_us, scan)
        self.number += 1
        answers = self.talk.say(MessageKind.SEQUENCE, self.number, scan.payload())
        self._note()
        found = [
            protocol.NAK.unpack(each.payload) for each in answers if each.kind == MessageKind.NAK
        ]
        if wanted is None:
            assert found == []
            self.judge.accept(scan, now_us)
            self.free_us = start_us
        else:
            assert found == [(Refusal.UNSAFE, *wanted)]
        self.decided[wanted and Rule(wanted[0])] += 1
        return wanted

    def send_in_parts(self, scan):
        """Send a scan in parts. At random, a part comes late, is wrong, or is the last one sent."""
        rng = self.rng
        cuts = sorted({0, *rng.integers(0, len(scan.slots) + 1, 3).tolist(), len(scan.slots)})
        scan.times = 1
        for at, end in itertools.pairwise(cuts):
            one = replace(scan, slots=scan.slots[at:end], goes_on=at > 0, more=end < cuts[-1])
            if one.more:
                one.recharge_ua, one.recharge_us = (), 0
            if rng.random() < 0.05:
                one.period_us, one.goes_on = one.period_us + 1, not one.goes_on
            if self.send(one) is not None and rng.random() < 0.8:
                return
            if rng.random() < 0.2:
                self.wait(int(rng.choice([100, 1000, 5000, 30_000, 1_200_000])))
            elif rng.random() < 0.05:
                return

    def report(self):
        """Check the figures of the last second and of the session in the board's REPORT."""
        self.judge.advance(self.talk.now_us)
        assert self.begun == self.judge.flowing
        if self.switched:
            # For a switched board, the emulator reports the currents through its skin model.
            return
        (report,) = (
            each for each in self.talk.say(MessageKind.STATUS) if each.kind == MessageKind.REPORT
        )
        charge_uc = -(-int(self.judge.session_pc.max()) // 1_000_000)
        seconds = -(-self.judge.flowing_us // 1_000_000)
        found = [int.from_bytes(report.payload[at:][:4], "little") for at in (41, 45, 49)]
        assert found == [self.judge.most_net_pc, seconds, charge_uc]

    def _note(self):
        """Record the starts of passes, from the pulses of their first slots."""
        self.begun += [each[4] for each in self.talk.pulses if each[1] == 0]
        self.talk.pulses = []

    def scan(self):
        rng = self.rng
        period_us = int(rng.choice([4999, 5000, 6250, 10_000, 20_000, 33_333, 60_000]))
        many, louder = int(rng.choice([0, 1, 2, 5, 12, 30])), int(rng.choice([20, 200, 3000]))
        width_us, rest_us = int(rng.integers(20, 204)), int(rng.choice([19, 20, 60]))
        slots, sign = [], int(rng.choice([0, 1, -1]))
        for _ in range(many):
            one, other = rng.permutation(ELECTRODES)[:2] if not sign else (0, 1)
            row = np.zeros(ELECTRODES, int)
            row[[one, other]] = (sign or 1) * np.array([1, -1])
            if not self.switched:
                row *= int(rng.integers(0, louder))
            slots.append((width_us, rest_us, tuple(int(each) for each in row)))
        scan = Scan(period_us, slots, int(rng.choice([1, 1, 1, 2, 9, 60, 300])))
        if self.switched:
            scan.source_ua = int(rng.integers(1, louder))
        elif rng.random() < 0.4:
            self._recharge(scan)
        if self.ramp:
            allowed = self.judge.allowed(self.judge.start_us(self.talk.now_us))
            scan.intensity = min(
                FULL, allowed + int(rng.choice([-5000, 0, 0, 1], p=[0.3, 0.3, 0.3, 0.1]))
            )
            scan.intensity = max(0, scan.intensity)
        return scan

    def _recharge(self, scan):
        """Add a recharge phase that removes 0.5, 1 or 2.1 times the net charge, or doubles it."""
        carried = self.judge.net_pc + self.judge._pass(scan, 0).net_pc
        scan.recharge_us = int(self.rng.integers(1, scan.period_us))
        back = -int(carried[0]) / scan.recharge_us * float(self.rng.choice([0.5, 1, 2.1, -1]))
        back = int(np.clip(back, -501, 501))
        scan.recharge_ua = (back, -back, 0, 0)

    def play(self, scans):
        """Send at least ``scans`` random scans, many of them at the edge of a rule."""
        while self.decided.total() < scans:
            if self.number == 0 or self.rng.random() < 0.03:
                self.begin()
            scan = self.scan()
            if self.rng.random() < 0.3:
                self.send_in_parts(scan)
            elif self.rng.random() < 0.5:
                self._edge(scan)
            else:
                self.send(scan)
            if self.rng.random() < 0.3:
                self.wait(int(self.rng.integers(1, 60_000)))
            if self.rng.random() < 0.01:
                self.wait(int(self.rng.choice([900_000, 14_990_000, 15_100_000])))
        self.report()
        return self

    def _edge(self, scan):
        """Vary one quantity of a scan; send the first refused value, then the last accepted one."""
        self.wait(max(0, self.free_us - self.talk.now_us))
        what = self.rng.choice(["times", "louder", "intensity", "period"])

        def changed(number):
            one = Scan(**vars(scan))
            if what == "times":
                one.times = number
            elif what == "intensity":
                one.intensity = number
            elif what == "period":
                one.period_us = 65_536 - number
            elif self.switched:
                one.source_ua = number
            else:
                one.slots = [
                    (width, rest, tuple(int(np.sign(ua)) * number for ua in row))
                    for width, rest, row in scan.slots
                ]
            return one

        right, wrong = 1, 6000 if what == "louder" else 65_535
        if self.judge.refusal(changed(right), self.talk.now_us) is not None:
            self.send(scan)
            return
        while wrong - right > 1:
            middle = (right + wrong) // 2
            if self.judge.refusal(changed(middle), self.talk.now_us) is None:
                right = middle
            else:
                wrong = middle
        self.send(changed(wrong))
        self.send(changed(right))


def often(life):
    """Begin more scans in a second than allowed, each in a session that ends after 4 ms."""
    limits = Limits(ramp_ms=500, current_ua=(5000,) * ELECTRODES)
    short = Scan(5000, [(20, 20, (2, -2, 0, 0))], intensity=0)
    for _ in range(260):
        life.begin(limits).send(short)
        life.wait(4000)
    assert life.decided[Rule.OFTEN] > 10
    return life


def net(life):
    """Send net charge of one sign for over a second, then of the other sign."""
    life.begin(Limits(felt_ua=(5000,) * ELECTRODES))
    for sign in (-1, 1, -1):
        one = Scan(20_000, [(200, 40, (sign * 1200, -sign * 1200, 0, 0))] * 5)
        for _ in range(60):
            life.send(one)
            life.wait(20_000)
    # Within a bucket of 50 ms, the second half removes the charge of the first half.
    life.wait(1_050_000 - life.talk.now_us % 50_000)
    for sign in [-1] * 5 + [1] * 5 + [1] * 20:
        life.send(Scan(5000, [(200, 40, (sign * 2500, -sign * 2500, 0, 0))] * 5))
        life.wait(max(0, life.judge.start_us(life.talk.now_us) - life.talk.now_us))
    assert life.decided[Rule.NET_IN_SECOND] > 20
    life.report()
    return life


def felt(life):
    """Send more felt pulses than allowed in a period, and more than allowed in a second."""
    life.begin(Limits(felt_ua=(0,) * ELECTRODES, session_s=9))
    pair = [(20, 20, (30, -30, 0, 0)), (20, 20, (-30, 30, 0, 0))]
    for slots in (61, 60, 60):
        for _ in range(40):
            life.send(Scan(38_000, (pair * 31)[:slots]))
            life.send(Scan(40_000, (pair * 31)[:slots], times=2))
    assert life.decided[Rule.FELT_IN_SECOND] > 5
    assert life.decided[Rule.FELT] > 5
    life.report()
    return life


def charge(life):
    """Exceed the charge limit over a second with scans that keep the limits over a period."""
    life.begin(Limits(felt_ua=(5000,) * ELECTRODES))
    pair = [(200, 40, (2500, -2500, 0, 0)), (200, 40, (-2500, 2500, 0, 0))]
    for _ in range(40):
        life.send(Scan(39_900, pair * 19))
        life.send(Scan(40_000, pair * 20, times=30))
    assert life.decided[Rule.CHARGE_IN_SECOND] > 5
    life.report()
    return life


def session(life):
    """Send scans until a session has used up its time, and until another has used up its charge."""
    loud = [(100, 40, (2000, -2000, 0, 0)), (100, 40, (-2000, 2000, 0, 0))]
    for session_s, session_uc in ((1, 1000), (9, 30)):
        life.begin(Limits(session_s=session_s, session_uc=session_uc))
        for _ in range(90):
            life.send(Scan(20_000, loud))
            life.wait(20_000)
        life.report()
    assert life.decided[Rule.SESSION_TIME] > 10
    assert life.decided[Rule.SESSION_CHARGE] > 10
    return life


def rise(life):
    """Raise intensity without, with weak and with strong current. Only current raises the level."""
    life.begin(Limits())
    silent, weak, enough = ({"of": part} for part in (None, 0.01, 1))
    for current, times, wait_us, claims in (
        (silent, 1, 20_000, 40), ({"of": 0}, 1, 20_000, 20), (weak, 1, 20_000, 20),
        (enough, 1, 20_000, 40), (weak, 1, 20_000, 20), (enough, 1, 20_000, 2),
        (silent, 1, 14_990_000, 1), (enough, 1, 14_990_000, 2), (enough, 1, 15_040_001, 2),
        (enough, 3, 20_000, 12),
    ):  # fmt: skip
        for _ in range(claims):
            top = life.judge.allowed(life.judge.start_us(life.talk.now_us))
            for intensity in (min(FULL, top + 1), top):
                life.send(Scan(20_000, _counting(intensity, **current), times, intensity))
            life.wait(wait_us)
        # A scan that has no slots and intensity 0 does not lower the level.
        life.send(Scan(20_000, [], 1, 0))
        life.wait(20_000)
    # Weak pulses that state a high intensity, followed by strong pulses.
    for intensity in (1000, FULL // 2, FULL):
        life.begin(Limits())
        life.send(Scan(500_000, _counting(FULL, 0.05), 1, intensity))
        life.wait(500_000)
        top = life.judge.allowed(life.judge.start_us(life.talk.now_us))
        for claimed in (FULL, top + 1, top):
            life.send(Scan(20_000, _counting(claimed, 1), 1, claimed))
    assert life.decided[Rule.RISE] > 30
    return life


def _counting(intensity, of):
    """Return a slot with ``of`` times the current that an intensity needs; if None, no slot."""
    if of is None:
        return []
    level = min(1250, int(of * -(-1250 * intensity // FULL)))
    return [(200, 40, (level, -level, 0, 0))]


def recharge(life):
    """Send recharge phases of each sign, also long ones that end near the end of the period."""
    life.begin(Limits())
    pulse = [(200, 40, (1000, -1000, 0, 0))]
    for sign in (1, -1):
        for _ in range(30):
            for back_us in (9000, 16_000, 19_739, 19_740, 19_741):
                life.send(Scan(20_000, pulse, 1, FULL, back_us, (-sign * 40, sign * 40, 0, 0)))
            life.wait(20_000)
    life.begin(Limits())
    for times in (1, 40, 400):
        life.send(Scan(20_000, pulse, times, FULL, 9000, (-30, 30, 0, 0)))
        life.wait(20_000)
    assert life.decided[Rule.RECHARGE] > 20
    assert {Rule.FIT, Rule.DUTY} <= set(life.decided)
    return life


def one_source(life):
    """Send slots of one source; two electrodes share its current if both touch the skin."""
    life.begin(Limits(charge_pc=(300_000,) * ELECTRODES))
    for source_ua in (3000, 3001, 5000, 5001):
        for states in ((1, 1, -1, -1), (1, -1, 0, 0)):
            life.send(Scan(20_000, [(100, 40, states)], source_ua=source_ua))
            life.send(Scan(20_000, [(59, 41, states)], source_ua=source_ua))
            life.wait(20_000)
    assert life.decided[Rule.CHARGE] > 2
    assert life.decided[Rule.TOTAL] + life.decided[Rule.CURRENT] > 1
    return life


def limits(life):
    """Begin sessions with limits that exceed the board's own, and with a limit left at zero."""
    loud = 6000
    each = {"current_ua": 65_535, "felt_ua": 65_535, "charge_pc": 1 << 31}
    wide = {"total_ua": 60_000, "width_us": 900, "full_ua": 65_535, "rounding_ua": 60_000,
            "ramp_ms": 1, "duty": 255, "session_s": 65_535, "session_uc": 1 << 31}  # fmt: skip
    wide |= {name: (most,) * ELECTRODES for name, most in each.items()}
    zeros = [{name: (0,) * ELECTRODES if name in each else 0} for name in wide]
    for given in ({}, wide, *zeros):
        life.begin(Limits(**given))
        for level_ua in (10, 700, 2490, 2510, loud):
            life.send(Scan(50_000, [(60, 40, (level_ua, -level_ua, 0, 0))] * 3, 1, 0))
            life.send(Scan(50_000, [(60, 40, (level_ua, -level_ua, 0, 0))] * 3, 1, 19_662))
            life.send(Scan(20_000, [(250, 40, (5, -5, 0, 0)), (20, 20, (9, -9, 0, 0))], 1, 0))
            life.wait(100_000)
    return life


def parts(life):
    """Send scans in parts. With its last part, a scan breaks a rule or barely keeps it."""
    pair = [(20, 20, (30, -30, 0, 0)), (20, 20, (-30, 30, 0, 0))]
    loud = [(200, 40, (2500, -2500, 0, 0)), (200, 40, (-2500, 2500, 0, 0))]
    weak = [(200, 40, (25, -25, 0, 0))]
    life.begin(Limits(felt_ua=(0,) * ELECTRODES, duty=30, session_s=3))
    for first, last, period_us in (
        (pair * 3, pair * 2, 5000), (pair * 3, pair, 5000), (loud * 4, loud, 10_000),
        (loud * 4, loud[:1], 10_000), (loud * 5, loud * 2, 10_000),
        (pair * 24, pair * 27, 40_000), ([(40, 1200, (2, -2, 0, 0))] * 3,) * 2 + (5000,),
        ([(200, 20, (2, -2, 0, 0))] * 6,) * 2 + (5000,),
    ):  # fmt: skip
        for wait_us in (0, 0, 700, 30_000):
            for intensity in (0, 9000, FULL):
                one = Scan(period_us, first, 1, intensity, more=True)
                for part in (
                    one,
                    Scan(period_us, last[:1], 1, intensity, more=True, goes_on=True),
                    Scan(period_us, last[1:] or weak, 1, intensity, goes_on=True),
                ):
                    life.send(part)
                    life.wait(wait_us)
        life.wait(20_000)
    # A scan of three parts counts once for the limit on scans per second.
    life.begin(Limits(period_us=20_000))
    for _ in range(80):
        for which in ({"more": True}, {"more": True, "goes_on": True}, {"goes_on": True}):
            life.send(Scan(20_000, [(20, 20, (2, -2, 0, 0))], 1, 0, **which))
    # A part must follow an incomplete scan, and have the same period.
    for period_us, which in (
        (20_000, {"more": True}),
        (20_001, {"goes_on": True}),
        (20_000, {"goes_on": True}),
        (20_000, {"goes_on": True}),
    ):
        life.send(Scan(period_us, weak, 1, 0, **which))
    assert {Rule.PART, Rule.FIT, Rule.DUTY, Rule.MEAN, Rule.FELT} <= set(life.decided)
    assert Rule.OFTEN not in life.decided
    life.report()
    return life


def rising_parts(life):
    """Raise the level by scans in two parts. Strong pulses are in either, neither or both parts."""
    weak, strong = ([(200, 40, (ua, -ua, 0, 0))] for ua in (30, 1000))
    life.begin(Limits())
    for first, last in ((weak, strong), (strong, weak), (weak, weak), (strong, strong)):
        for _ in range(12):
            top = life.judge.allowed(life.judge.start_us(life.talk.now_us))
            for intensity in (min(FULL, top + 1), top):
                for slots, which in ((first, {"more": True}), (last, {"goes_on": True})):
                    life.send(Scan(20_000, slots, 1, intensity, **which))
                    life.wait(7000)
        life.wait(15_100_000)
    assert life.decided[Rule.RISE] > 10
    return life


LIVES = (often, net, felt, charge, session, rise, recharge, one_source, limits, parts,
         rising_parts)  # fmt: skip
