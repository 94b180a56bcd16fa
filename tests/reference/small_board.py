"""A small board of the link, from ``docs/reference/link.md`` alone: no code of the package.

It has four weighted electrodes and time as it is told. Of the rules it has those on current, rise
and parts, which is enough for most of the vectors; it is no board for a finger.
"""

import hashlib
import struct

from tests.reference import small_link as wire
from tests.reference.small_link import FULL, E


class Board:
    def __init__(self, ramp_ms=500, slots=4096, packet=1 << 20):
        self.room = slots, packet
        self.own_ramp_ms, self.challenge = ramp_ms, 1
        self.session = self.taken = self.said = self.heard_us = self.alive_us = self.violations = 0
        self.live = self.greeted = False
        self.kept, self.size, self.identity, self.table = b"", 0, bytes(16), None
        self.sequences = self.slots = self.pulses = self.most_ua = self.most_pc = self.most_net = 0
        self.passes, self.running, self.waiting, self.last, self.scan = [], None, None, -1, None
        self.scan_end_us = 0

    def feed(self, data, now_us):
        answer, pulses = self.advance(now_us)
        for packet in wire.unframe(data):
            answer += self._take(*packet, now_us)
        return answer + self._told(pulses, now_us), pulses

    def advance(self, now_us):
        self.out, pulses = b"", []
        self._execute(min(now_us, self.heard_us + 100_000), pulses)
        if self.live and now_us >= self.heard_us + 100_000:
            dropped, self.waiting, self.live = self.waiting, None, False
            self._end(self.heard_us + 100_000)
            self.running = None
            if dropped:
                self._nak(dropped["number"], 5)
        if self.greeted and now_us - self.alive_us >= 20_000:
            self.alive_us = now_us
            self._say(wire.ALIVE, 0, struct.pack("<h", 1000))
        answer, self.out = self.out, b""
        return answer, pulses

    def _told(self, pulses, now_us):
        self._execute(now_us, pulses)
        answer, self.out = self.out, b""
        return answer

    def _say(self, kind, about=0, payload=b""):
        self.said += 1
        self.out += wire.frame(kind, self.said, self.session, self.taken, about, payload)

    def _nak(self, about, reason, rule=0, slot=0xFFFF, electrode=0xFFFF, value=0, allowed=0):
        self.violations += reason in (2, 3)
        self._say(
            wire.NAK, about, struct.pack("<BBHHii", reason, rule, slot, electrode, value, allowed)
        )

    def _take(self, kind, number, session, heard, about, payload, now_us):
        if kind == wire.HELLO:
            slots, packet = self.room
            offer = struct.pack("<HBBHHHH", E, 0, 31, 5000, slots, 100, 300)
            offer += struct.pack("<IIH", 1 << 23, packet, 4096) + b"SmartTouch board emulator 1"
            return wire.frame(wire.OFFER, 0, session | self.challenge << 32, 0, number, offer)
        if kind == wire.BEGIN and session >> 32 == self.challenge and session & 0xFFFFFFFF:
            self.session, self.live, self.greeted, self.said = session, True, True, 0
            self.challenge, self.last, self.limits, self.scan = self.challenge + 1, -1, None, None
            self.level = self.strength = self.since_us = self.span_us = 0
            self.session_us, self.session_pc, self.net_pc = 0, [0] * E, [0] * E
        elif session != self.session or number <= self.taken:
            return b""
        self.taken, self.heard_us = number, now_us
        if kind == wire.BEGIN:
            self._say(wire.BEGUN, number)
        elif kind == wire.LIMITS:
            self.limits = self.limits or struct.unpack_from(f"<IIHHHHHHIBBH{E}H{E}H{E}I", payload)
            self.ramp_us = 1000 * self.own_ramp_ms and 1000 * max(500, self.limits[6])
            self._say(wire.LIMITED, number, b"\1")
        elif kind == wire.KERNELS:
            self._keep(payload)
            proof = bytes(16)
            if self.table:
                proof = hashlib.sha256(struct.pack("<Q", session) + self.kept).digest()[:16]
            whole = self.identity, len(self.kept), self.table is not None, proof
            self._say(wire.KEPT, number, struct.pack("<16sI?16s", *whole))
        elif kind == wire.STATUS:
            at_hand = bool(self.running) + bool(self.waiting)
            seconds, charge_uc = -(-self.session_us // 10**6), -(-max(self.session_pc) // 10**6)
            self._say(wire.REPORT, number, struct.pack(
                "<IIQIIIIBIIIII", self.sequences, self.slots, self.pulses, self.violations,
                self.most_ua, self.most_pc, 0, at_hand, 0, 0, self.most_net, seconds, charge_uc,
            ))  # fmt: skip
        elif kind == wire.STOP:
            self._end(now_us)
            self.running, self.waiting, self.live = None, None, False
            self._say(wire.STOPPED, number)
        elif kind == wire.SEQUENCE:
            self._accept(about, payload, now_us)
        answer, self.out = self.out, b""
        return answer

    def _keep(self, payload):
        identity, size, offset = struct.unpack_from("<16sII", payload)
        if (identity, size) != (self.identity, self.size):
            self.kept, self.size, self.identity, self.table = b"", size, identity, None
        if offset == len(self.kept):
            self.kept += payload[24:]
        if len(self.kept) == size and hashlib.sha256(self.kept).digest()[:16] == identity:
            self.table, at = [], 4
            for _ in range(struct.unpack_from("<H", self.kept, 2)[0]):
                site, runs = struct.unpack_from("<HH", self.kept, at)
                weights, at = [0] * E, at + 4
                for _ in range(runs):
                    first, count = struct.unpack_from("<HH", self.kept, at)
                    some = struct.unpack_from(f"<{count}h", self.kept, at + 4)
                    weights[first : first + count] = some
                    at += 4 + 2 * count
                self.table.append((site, weights))

    def _read(self, payload):
        period_us, times, intensity, flags, count = struct.unpack_from("<IHHBB", payload)
        shapes = [struct.unpack_from("<HH", payload, 10 + 4 * each) for each in range(count)]
        at, slots = 10 + 4 * count, []
        while at < len(payload):
            kind, shape, number = struct.unpack_from("<BBH", payload, at)
            at += 4
            rows = [payload[at + k * (4, 4, 2 + 2 * E)[kind] :] for k in range(number)]
            at += number * (4, 4, 2 + 2 * E)[kind]
            if kind == 2:
                found = [struct.unpack_from(f"<H{E}h", row) for row in rows]
                slots += [(*shapes[shape], site, list(current)) for site, *current in found]
                continue
            pairs = [struct.unpack_from("<HH", row) for row in rows]
            for group in [pairs] if kind else [[pair] for pair in pairs]:
                so_far, carried, currents = 0, 0, []
                for each in range(E):
                    carried += sum(self.table[k][1][each] * a for k, a in group)
                    so_far, before = (carried + 2**16) >> 17, so_far
                    currents.append(so_far - before)
                slots.append((*shapes[shape], self.table[group[0][0]][0], currents))
        return {"period": period_us, "times": times, "left": times, "intensity": intensity,
                "more": bool(flags & 4), "goes_on": bool(flags & 8), "slots": slots}  # fmt: skip

    def _accept(self, number, payload, now_us):
        if not self.live:
            return self._nak(number, 4)
        scan, running = self._read(payload), self.running
        scan |= {"number": number, "came": now_us}
        start_us = now_us
        if running:
            start_us = max(now_us, self._over(running) if scan["goes_on"] else running["end"])
        before = self.scan
        if scan["goes_on"] and not (before and before["more"]):
            return self._nak(number, 3, 28)
        peak_pc = max((abs(i) * slot[0] for slot in scan["slots"] for i in slot[3]), default=0)
        peak_ua = max((abs(i) for slot in scan["slots"] for i in slot[3]), default=0)
        most_ua = min(5000, self.limits[3]) * scan["intensity"] // FULL + min(3, self.limits[4])
        if peak_ua > most_ua:
            return self._nak(number, 3, 17, value=peak_ua, allowed=most_ua)
        if scan["goes_on"]:
            peak_pc, start_us = max(peak_pc, before["peak"]), before["start"]
        strength, allowed = (
            self._strength(scan["intensity"], peak_pc),
            self._allowed(start_us, scan),
        )
        if strength > allowed:
            return self._nak(number, 3, 18, value=strength, allowed=allowed)
        self.scan = {"more": scan["more"], "peak": peak_pc, "start": start_us,
                     "rise": before["rise"] if scan["goes_on"] else self._rise()}  # fmt: skip
        self._note(scan, strength, start_us)
        self.last = number
        if running:
            self.waiting = scan
        else:
            self._begin(scan, now_us)
        return None

    def _rise(self):
        return self.level, self.strength, self.since_us, self.span_us

    def _risen(self, rise, start_us):
        level, strength, since_us, span_us = rise
        on_us = min(max(0, start_us - since_us), span_us)
        if start_us - since_us - on_us > 15_000_000:
            return 0, on_us
        return max(level, min(strength, level + on_us * FULL // self.ramp_us)), on_us

    def _allowed(self, start_us, scan):
        rise = self.scan["rise"] if scan["goes_on"] else self._rise()
        if not self.ramp_us:
            return FULL
        return min(FULL, self._risen(rise, start_us)[0] + 150_000 * FULL // self.ramp_us + 2)

    def _strength(self, intensity, peak_pc):
        share = -(-peak_pc * FULL // (self.limits[3] * self.limits[11]))
        return min(FULL, max(share, min(intensity, 4 * share)))

    def _note(self, scan, strength, start_us):
        if not self.ramp_us:
            return
        level, on_us = self._risen(self.scan["rise"], start_us)
        if strength:
            self.level, self.strength = min(scan["intensity"], level), strength
            self.since_us, self.span_us = start_us, scan["times"] * scan["period"]
        else:
            self.level, self.since_us, self.span_us = level, self.since_us + on_us, 0

    def _over(self, scan):
        return scan["start"] + sum(width + rest for width, rest, *_ in scan["slots"])

    def _begin(self, scan, start_us):
        self._pass(scan, start_us)
        self.running = scan
        self._say(wire.ACK, scan["number"], struct.pack("<Q", start_us))

    def _pass(self, scan, start_us):
        scan |= {"start": start_us, "done": 0, "next": start_us, "end": start_us + scan["period"]}
        if scan["goes_on"]:
            scan["end"] = max(self.scan_end_us, self._over(scan))
        elif scan["slots"]:
            self.session_us += scan["period"]
        if not scan["slots"]:
            return
        net = [sum(slot[0] * slot[3][e] for slot in scan["slots"]) for e in range(E)]
        oldest = start_us // 50_000 - 20
        sums = [0] * E
        for _, each in [(0, net), *reversed([p for p in self.passes if p[0] >= oldest])]:
            sums = [a + b for a, b in zip(sums, each, strict=True)]
            self.most_net = max(self.most_net, *map(abs, sums))
        scan["net"] = net
        for e in range(E):
            self.session_pc[e] += sum(slot[0] * abs(slot[3][e]) for slot in scan["slots"])

    def _end(self, until_us):
        if self.running and self.running["slots"]:
            over_us = min(until_us, self._over(self.running))
            self.passes.append((over_us // 50_000, self.running["net"]))

    def _execute(self, until_us, pulses):
        while scan := self.running:
            for number, (width, rest, site, current) in enumerate(scan["slots"]):
                if number >= scan["done"] and scan["next"] <= until_us:
                    pulses.append([scan["number"], number, site, width, scan["next"], current])
                    scan["next"] += width + rest
                    scan["done"] += 1
                    self.slots += 1
                    self.pulses += sum(map(bool, current))
                    self.most_ua = max(self.most_ua, *map(abs, current))
                    self.most_pc = max(self.most_pc, *(width * abs(each) for each in current))
            waiting, end_us = self.waiting, scan["end"]
            if waiting and waiting["goes_on"]:
                end_us = max(self._over(scan), waiting["came"])
            if until_us < end_us:
                return
            self._end(until_us)
            scan["left"] -= 1
            if scan["left"] and not waiting:
                self._pass(scan, end_us)
                continue
            self.scan_end_us, self.sequences = scan["end"], self.sequences + (not scan["more"])
            self.running = self.waiting = None
            if waiting:
                self._begin(waiting, end_us)
