"""A small board of the link, from ``docs/reference/link.md`` alone: no code of the package.

It has four weighted electrodes, and its time is given. Of the rules it has those that its vectors
need: none on charge or on the last second. It is no board for a finger.
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
        self.scan_end_us, self.measured, self.most_left, self.left = 0, [], 0, b""

    def feed(self, data, now_us, measured=()):
        """Take bytes, and what is measured of the pulses until then; return answer and pulses."""
        answer, pulses = self.advance(now_us, measured)
        *pieces, self.left = (self.left + data).split(b"\0")
        found = [wire.unframe(piece) for piece in pieces if piece]
        for packet in filter(None, found):
            answer += self._take(*packet[0], now_us)
            self.out = b""
        if not all(found) and self.greeted:
            self._nak(0, 6)
            answer, self.out = answer + self.out, b""
        return answer + self._told(pulses, now_us), pulses

    def advance(self, now_us, measured=()):
        self.out, pulses = b"", []
        self.measured += measured
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
        self.out = b""
        if kind in (wire.HELLO, wire.BEGIN) and self.live and session != self.session:
            self._nak(0, 8)
            return self.out
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
            if self.live:
                self._nak(0, 7 if session == self.session else 8)
            return self.out
        self.taken, self.heard_us = number, now_us
        if kind == wire.BEGIN:
            self._say(wire.BEGUN, number)
        elif kind == wire.LIMITS:
            if len(payload) == 28 + 8 * E:
                told = struct.unpack(f"<IIHHHHHHIBBH{E}H{E}H{E}I", payload)
                self.limits = self.limits or told
                self.ramp_us = 1000 * self.own_ramp_ms and 1000 * max(500, self.limits[6])
            self._say(wire.LIMITED, number, bytes([self.limits is not None]))
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
                self.most_ua, self.most_pc, self.most_left, at_hand, 0, 0, self.most_net, seconds,
                charge_uc,
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
        if len(payload) < 24 or self.running:
            return
        identity, size, offset = struct.unpack_from("<16sII", payload)
        if (identity, size) != (self.identity, self.size):
            self.kept, self.size, self.identity, self.table = b"", size, identity, None
        if size > 1 << 23:
            self.size, self.identity = 0, bytes(16)
            return
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
        """Return what a SEQUENCE says; raise if that is not exactly one sequence."""
        period_us, times, intensity, flags, count = struct.unpack_from("<IHHBB", payload)
        if not times:
            raise IndexError(times)
        shapes = [struct.unpack_from("<HH", payload, 10 + 4 * each) for each in range(count)]
        at, slots, recharge = 10 + 4 * count, [], [0]
        if flags & 2:
            recharge = struct.unpack_from(f"<H{E}h", payload, at)
            at += 2 + 2 * E
        while at < len(payload):
            kind, shape, number = struct.unpack_from("<BBH", payload, at)
            at, size = at + 4, (4, 4, 2 + 2 * E, 4 + (E + 3) // 4)[kind]
            rows = [payload[at + k * size : at + (k + 1) * size] for k in range(number)]
            if not number or not all(len(row) == size for row in rows):
                raise IndexError(number)
            at += number * size
            if kind == 3:
                slots += [(*shapes[shape], 0, [0] * E, (8, 3, 0))] * number
            elif kind == 2:
                found = [struct.unpack(f"<H{E}h", row) for row in rows]
                slots += [(*shapes[shape], site, list(ua), None) for site, *ua in found]
            else:
                pairs = [struct.unpack("<HH", row) for row in rows]
                for group in [pairs] if kind else [[pair] for pair in pairs]:
                    slots.append((*shapes[shape], *self._sum(group)))
        return {"period": period_us, "times": times, "left": times, "intensity": intensity,
                "more": bool(flags & 4), "asks": flags & 1, "recharge": recharge,
                "goes_on": bool(flags & 8), "slots": slots}  # fmt: skip

    def _sum(self, group):
        """Return site and currents of a slot of kernels, and what of rules 9 and 10 it breaks."""
        table = self.table or []
        for kernel, _ in group:
            if kernel >= len(table):
                return 0, [0] * E, (9, kernel, len(table))
        if (total := sum(amplitude for _, amplitude in group)) > FULL:
            return 0, [0] * E, (10, total, FULL)
        so_far, carried, currents = 0, 0, []
        for each in range(E):
            carried += sum(table[kernel][1][each] * amplitude for kernel, amplitude in group)
            so_far, before = (carried + 2**16) >> 17, so_far
            currents.append(so_far - before)
        return table[group[0][0]][0], currents, None

    def _broken(self, scan):
        """Return rule, slot, electrode, value and what is allowed of the first rule broken."""
        limits, slots, none = self.limits, scan["slots"], 0xFFFF
        if not limits:
            return 1, none, none, 0, 0
        if scan["goes_on"] and not (self.scan and self.scan["more"]):
            return 28, none, none, 0, 0
        if len(slots) > self.room[0]:
            return 2, none, none, len(slots), self.room[0]
        if scan["period"] < (least := max(5000, limits[0])):
            return 3, none, none, scan["period"], least
        for at, (width, rest, *_) in enumerate(slots):
            if not 0 < width <= (most := min(200, limits[2])):
                return 4, at, none, width, most
            if rest < 20:
                return 5, at, none, rest, 20
        recharge_us, *recharge_ua = scan["recharge"]
        flowing_us = sum(slot[0] for slot in slots) + recharge_us
        rest_us = sum(slot[1] for slot in slots) + 20 * bool(recharge_us)
        for rule, value, allowed in [
            (6, flowing_us + rest_us, scan["period"]),
            (7, flowing_us, scan["period"] * min(80, limits[9]) // 100),
        ]:
            if value > allowed:
                return rule, none, none, value, allowed
        for at, (width, _, _, currents, wrong) in enumerate(slots):
            if wrong:
                return wrong[0], at, none, *wrong[1:]
            if sum(currents):
                return 11, at, none, sum(currents), 0
            for e, ua in enumerate(currents):
                if abs(ua) > (most := min(5000, limits[12 + e])):
                    return 12, at, e, abs(ua), most
            if (total := sum(ua for ua in currents if ua > 0)) > (most := min(10_000, limits[1])):
                return 13, at, none, total, most
            for e, ua in enumerate(currents):
                if width * abs(ua) > (most := min(500_000, limits[12 + 2 * E + e])):
                    return 14, at, e, width * abs(ua), most
        return (11, none, none, sum(recharge_ua), 0) if sum(recharge_ua) else None

    def _accept(self, number, payload, now_us):
        if not self.live:
            return self._nak(number, 4)
        if number < self.last:
            return self._nak(0, 7)
        if number == self.last:
            if not self.waiting or self.waiting["number"] != number:
                self._say(wire.ACK, number, struct.pack("<Q", self.begun_us))
            return None
        if self.waiting:
            return self._nak(number, 1)
        try:
            scan, running = self._read(payload), self.running
        except (IndexError, struct.error):
            return self._nak(number, 2)
        if broken := self._broken(scan):
            return self._nak(number, 3, *broken)
        scan |= {"number": number, "came": now_us}
        start_us = now_us
        if running:
            start_us = max(now_us, self._over(running) if scan["goes_on"] else running["end"])
        before = self.scan
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
        self.running, self.begun_us = scan, start_us
        self._say(wire.ACK, scan["number"], struct.pack("<Q", start_us))

    def _pass(self, scan, start_us):
        scan |= {
            "start": start_us,
            "done": 0,
            "volts": [],
            "next": start_us,
            "end": start_us + scan["period"],
        }
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
            for number, (width, rest, site, current, _) in enumerate(scan["slots"]):
                if number >= scan["done"] and scan["next"] <= until_us:
                    pulses.append([scan["number"], number, site, width, scan["next"], current])
                    scan["next"] += width + rest
                    scan["done"] += 1
                    if self.measured:
                        volts, left_pc = self.measured.pop(0)
                        scan["volts"].append(volts)
                        self.most_left = max(self.most_left, left_pc)
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
            if scan["asks"]:
                self._say(
                    wire.VOLTAGES,
                    scan["number"],
                    struct.pack(f"<{len(scan['volts'])}H", *scan["volts"]),
                )
            scan["left"] -= 1
            if scan["left"] and not waiting:
                self._pass(scan, end_us)
                continue
            self.scan_end_us, self.sequences = scan["end"], self.sequences + (not scan["more"])
            self.running = self.waiting = None
            if waiting:
                self._begin(waiting, end_us)
