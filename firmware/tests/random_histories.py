"""Random histories of hosts and a board, reproducible from their seed."""

import numpy as np

from firmware.tests.core_and_emulator import Talk, encode_lists
from smarttouch.boards.link import MessageKind
from smarttouch.boards.link.sequence_encoding import KernelImage
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelLists, KernelTable, ScanSequence, quantized


def random_table(rng, kernels, electrodes):
    """Return a table of balanced kernels, some of which have zero weights."""
    weights = rng.normal(size=(kernels, electrodes))
    weights[rng.random(weights.shape) < rng.choice([0.0, 0.7], size=(kernels, 1))] = 0
    weights[:, 0] -= weights.sum(axis=1)
    site = (np.arange(kernels) % electrodes).astype(np.uint16)
    return KernelTable(quantized(weights), site, {}, {})


def random_lists(rng, table, slots, most=3, loud=4000):
    """Return slots that are random sums of kernels, with total amplitudes below ``loud``."""
    first = np.concatenate([[0], rng.integers(1, most + 1, slots).cumsum()])
    count = int(first[-1])
    kernel = rng.integers(0, len(table.weights), count).astype(np.uint16)
    amplitude = rng.integers(0, loud // most, count).astype(np.uint16)
    return KernelLists(table, first.astype(np.intp), kernel, amplitude)


def sequence_of(lists, **other):
    """Return a scan sequence with the currents that kernel lists describe."""
    column = np.ones(len(lists.first) - 1, np.uint16)
    fields = {
        "current_ua": lists.current_ua, "width_us": 100 * column, "discharge_us": 50 * column,
        "site": lists.site, "period_us": 10_000, "intensity": 1.0, "time_ns": 0, "sums": lists,
    }  # fmt: skip
    return ScanSequence(**(fields | other))


class Scene:
    """Random history of a board: hosts come and go, and sometimes break a rule.

    With ``worn``, emulator and core have the same skin model, and hosts request voltages. Hosts
    then send no recharge phases, because emulator and core report these at different times.
    """

    def __init__(self, board, seed, electrodes=6, output="weighted", ramp_ms=0, worn=False):
        self.ramp_ms, self.worn = ramp_ms, worn
        self.rng = np.random.default_rng(seed)
        self.electrodes, self.switched = electrodes, output != "weighted"
        self.limits = SafetyLimits(electrodes, 3.0, 200, 0.5, 200, 0.8, 0.5, 2.4, total_ma=6.0)
        self.talk, self.number, self.begun = Talk(board), 0, False

    def chance(self, share):
        return self.rng.random() < share

    def play(self, steps):
        for _ in range(steps):
            if not self.begun or self.chance(0.03):
                self._begin()
            act = self.rng.choice(
                [self._send, self._noise, self._time, self._other], p=[0.5, 0.1, 0.3, 0.1]
            )
            act()

    def _begin(self):
        if self.begun and self.chance(0.5):
            self.talk.say(MessageKind.STOP)
        elif self.begun:
            self.talk.wait(int(self.rng.integers(95_000, 130_000)))
        self.image = KernelImage.of(random_table(self.rng, 9, self.electrodes), 400, 8)
        self.talk.begin(self.limits if self.chance(0.9) else None)
        if self.chance(0.9):
            self.talk.give(self.image)
        self.number, self.begun = 0, True

    def _time(self):
        self.talk.wait(int(self.rng.integers(1, 30_000)), int(self.rng.choice([50, 1000, 7000])))
        if self.chance(0.8):
            self.talk.say(MessageKind.HEARTBEAT)

    def _noise(self):
        data = self.rng.bytes(int(self.rng.integers(1, 40)))
        if self.chance(0.5):
            packet = bytearray(self.talk.host.encode(MessageKind.STATUS))
            packet[int(self.rng.integers(len(packet)))] ^= 1 << int(self.rng.integers(8))
            data = bytes(packet)
        if self.chance(0.5):
            data += b"\0"
        self.talk.say(None, data=data)

    def _other(self):
        kind = self.rng.choice(
            [
                MessageKind.STATUS,
                MessageKind.LIMITS,
                MessageKind.KERNELS,
                MessageKind.BEGIN,
                MessageKind.HELLO,
                99,
            ]
        )
        self.talk.say(int(kind), payload=self.rng.bytes(int(self.rng.integers(0, 40))))

    def _send(self):
        self.number += int(self.rng.choice([0, 1, 1, 1, 1, 1, 2]))
        payload = bytearray(self._payload())
        if self.chance(0.15):
            payload[int(self.rng.integers(len(payload)))] ^= 1 << int(self.rng.integers(8))
        if self.chance(0.05):
            del payload[int(self.rng.integers(len(payload))) :]
        if len(payload) > 8 and not self.worn:
            payload[8] &= 0xFE
        packet = self.talk.host.encode(MessageKind.SEQUENCE, self.number, bytes(payload))
        cut = int(self.rng.integers(1, len(packet)))
        self.talk.say(None, data=packet[:cut])
        self.talk.wait(int(self.rng.integers(0, 3000)))
        self.talk.say(None, data=packet[cut:])

    def _payload(self):
        rng, slots = self.rng, int(self.rng.integers(0, 7))
        intensity = float(rng.choice([0.25, 0.3, 0.5, 1.0] if self.ramp_ms else [1.0, 0.5, 0.1]))
        loud = int(5000 * rng.choice([intensity, intensity, intensity, 2.0]))
        lists = random_lists(rng, self.image.table, slots, loud=loud)
        other = {"intensity": intensity}
        if self.switched:
            cathode = rng.integers(0, self.electrodes, slots)
            level = int(intensity * 100)
            every = np.arange(self.electrodes) == cathode[:, None]
            current = np.where(every, level * (self.electrodes - 1), -level)
            other["current_ua"] = current.astype(np.int16)
        elif not self.worn and self.chance(0.3):
            back = rng.integers(-80, 81, self.electrodes // 2)
            other["recharge_ua"] = np.repeat(back, 2).astype(np.int16)
            other["recharge_ua"][1::2] *= -1
            other["recharge_us"] = int(rng.integers(0, 9000))
        if self.chance(0.2):
            other["width_us"] = rng.integers(20, 204, slots).astype(np.uint16)
        if self.chance(0.05):
            other["discharge_us"] = np.full(slots, rng.choice([10, 19, 3000]), np.uint16)
        if self.chance(0.05):
            other["period_us"] = int(rng.choice([4999, 5000, 900]))
        if self.chance(0.05) and slots > 2 and not self.switched:
            # Strong pulses at one electrode have too much charge for a period.
            much = np.zeros((30, self.electrodes), np.int16)
            much[:, :2] = rng.choice([1900, 2600, 3100]) * np.array([1, -1])
            other |= {"current_ua": much, "sums": None, "intensity": 1.0}
            for name, value in (("width_us", 200), ("discharge_us", 40), ("site", 0)):
                other[name] = np.full(30, value, np.uint16)
        image = self.image if self.chance(0.8) else None
        sequence = sequence_of(lists, **other)
        wrong = sequence.recharge_ua is None and self.chance(0.03)
        times, switched = int(rng.integers(1, 4)), self.switched != wrong
        measure = self.worn and self.chance(0.7)
        return encode_lists(sequence, times, measure, switched, image, 1 << 20)
