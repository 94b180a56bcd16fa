"""The C core in this process and the Python emulator, to compare them in simulated time."""

import ctypes
import itertools

import numpy as np

from smarttouch.boards import link as protocol
from smarttouch.boards.link import OUTPUTS, MessageKind
from smarttouch.boards.link.link_driver import LinkSession
from smarttouch.boards.link.sequence_encoding import (
    OVERHEAD,
    KernelImage,
    encode_limits,
    encode_scan,
)
from smarttouch.boards.reports import Capabilities
from smarttouch.emulator.firmware_base import DeliveryLog
from smarttouch.emulator.link_board import NAME, LinkFirmware
from smarttouch.emulator.link_packets import BoardSession, encode_volts
from smarttouch.emulator.skin import COMPLIANCE_V, SkinCircuit

ROOM = 1 << 22
_RECHARGE = 4
BOOKS = ("sequences", "slots", "pulses", "violations", "framing_errors", "old_packets",
         "foreign_packets")  # fmt: skip


WEAR = ctypes.CFUNCTYPE(
    None, ctypes.POINTER(ctypes.c_uint32), ctypes.c_uint64, ctypes.POINTER(ctypes.c_int16),
    ctypes.POINTER(ctypes.c_uint32),
)  # fmt: skip


class Core:
    """Board that runs the C core in this process, and collects sent bytes and begun pulses."""

    out = np.zeros(ROOM, np.uint8)
    columns = tuple(np.zeros(ROOM // 4, np.uint32) for _ in range(4))
    starts, currents = np.zeros(ROOM // 4, np.uint64), np.zeros(ROOM, np.int16)

    def __init__(self, library, electrodes, output="weighted", ramp_ms=500, played=True):
        self._core = ctypes.CDLL(str(library))
        for name in ("st_rig_new", "st_rig_reason"):
            getattr(self._core, name).restype = ctypes.c_void_p
        self.electrodes = electrodes
        features = 27 + _RECHARGE * (output == "weighted")
        self._name = ctypes.create_string_buffer(NAME.encode())
        self._rig = ctypes.c_void_p(
            self._core.st_rig_new(
                electrodes,
                1 + OUTPUTS.index(output),
                features,
                int(COMPLIANCE_V),
                ramp_ms,
                played,
                self._name,
            )
        )

    def close(self):
        self._core.st_rig_free(self._rig)

    def wear(self, skin):
        """Attach a skin: a function of a pulse's width, discharge time, source current, start and
        currents. It returns the source voltage in units of 10 mV, and the largest charge, pC, that
        has remained on an electrode so far."""

        def pulse(times, start_us, current_ua, found):
            found[0], found[1] = skin(*times[:3], start_us, current_ua[: self.electrodes])

        self._pulse = WEAR(pulse)
        self._core.st_rig_wear(self._rig, self._pulse)
        return self

    def driven_pc(self):
        """Return the net charge that has been driven through each electrode."""
        found = (ctypes.c_int64 * self.electrodes)()
        self._core.st_rig_driven(self._rig, found)
        return list(found)

    def feed(self, data, now_us):
        self._core.st_rig_feed(self._rig, data, ctypes.c_size_t(len(data)), ctypes.c_uint64(now_us))
        return self.take()

    def advance(self, now_us):
        self._core.st_rig_advance(self._rig, ctypes.c_uint64(now_us))
        return self.take()

    def hang_up(self, now_us):
        self._core.st_rig_hang_up(self._rig, ctypes.c_uint64(now_us))
        self.take()

    def switch(self, is_open):
        """Open or close the emergency switch."""
        self._core.st_rig_switch(self._rig, is_open)

    def zero(self):
        self._core.st_rig_zero(self._rig)
        self.take()

    def take(self):
        """Return the bytes sent and the pulses begun since the last call."""
        count = ctypes.c_uint32()
        every = (self.out, *self.columns, self.starts, self.currents)
        pointers = [each.ctypes.data_as(ctypes.c_void_p) for each in every]
        size = self._core.st_rig_take(self._rig, *pointers, ctypes.byref(count))
        pulses = count.value
        rows = self.currents[: pulses * self.electrodes].reshape(pulses, self.electrodes).tolist()
        columns = (each[:pulses].tolist() for each in (*self.columns, self.starts))
        return self.out[:size].tobytes(), list(zip(*columns, rows, strict=True))

    def books(self):
        found = (ctypes.c_uint64 * 9)()
        self._core.st_rig_books(self._rig, found)
        return dict(zip((*BOOKS, "max_current_ua", "max_charge_pc"), found, strict=True))

    @property
    def reason(self):
        return ctypes.cast(self._core.st_rig_reason(self._rig), ctypes.c_char_p).value.decode()


class Worn:
    """The emulator's skin model, attached to a board of the C core."""

    def __init__(self, electrodes, switched=False):
        self.skin, self.switched = SkinCircuit(electrodes), switched
        self.shorted_us = self.left_uc = 0

    def __call__(self, width_us, rest_us, source_ua, start_us, current_ua):
        self.skin.short(max(0, start_us - self.shorted_us))
        if self.switched:
            state = np.array(current_ua, np.int8)
            delivered = self.skin.switched_pulse(state, float(source_ua), width_us)
        else:
            delivered = self.skin.pulse(np.array(current_ua, float), width_us)
        self.skin.short(rest_us)
        self.shorted_us = start_us + width_us + rest_us
        self.left_uc = max(self.left_uc, float(np.abs(self.skin.residual_uc).max()))
        return in_10_mv(delivered.source_v), round(1e6 * self.left_uc)


def in_10_mv(volts):
    return int.from_bytes(encode_volts(np.array([volts])), "little")


class PulseBooks(DeliveryLog):
    """Delivery log with pulses as `Core` reports them. If not ``worn``, remaining charge is 0."""

    worn = False

    def enter(self, number, slot, site, delivered, width_us, residual_uc, time_us, **more):
        super().enter(number, slot, site, delivered, width_us, residual_uc, time_us, **more)
        if not self.worn:
            self.max_net_charge_uc = 0.0
        current = np.rint(delivered.current_ua).astype(int).tolist()
        self.kept.append((number, slot, site, round(width_us), time_us, current))


class Emulated:
    """The Python emulator. It numbers sessions from 1, whereas a board draws random numbers."""

    def __init__(self, electrodes, output="weighted", ramp_ms=500, worn=False, **given):
        self.log = PulseBooks(electrodes)
        self.log.worn, self.log.kept = worn, []
        session = BoardSession(itertools.count(1).__next__)
        self._board = LinkFirmware(output, self.log, session=session, ramp_ms=ramp_ms, **given)

    def feed(self, data, now_us):
        return self._board.feed(data, 1000 * now_us), self._taken()

    def advance(self, now_us):
        return self._board.advance(1000 * now_us), self._taken()

    def hang_up(self, now_us):
        self._board.hang_up(1000 * now_us)
        self._taken()

    def switch(self, is_open):
        """Open or close the emergency switch."""
        self._board.switch_open = is_open

    def _taken(self):
        taken, self.log.kept = self.log.kept, []
        return taken

    def books(self):
        return {name: getattr(self.log, name) for name in BOOKS}

    def driven_pc(self):
        """Return the net charge that has been driven through each electrode."""
        return (1e6 * self.log.passed_uc).tolist()


class Both:
    """Boards that get the same bytes, and must answer and deliver the same.

    If ``felt`` is false, pulse currents may differ. The emulator reports a recharge phase when the
    phase ends, the core when it begins. So `recharges` lists these phases for each board, with
    numbers, starts and currents, and `Both` does not compare them."""

    def __init__(self, *boards, felt=True):
        self.boards, self._reported = boards, None if felt else 5
        self.said, self.recharges = b"", [[] for _ in boards]

    def _same(self, found):
        first, *others = found
        for other in others:
            assert other == first
        return first

    def _told(self, found):
        told = []
        for (answer, pulses), recharges in zip(found, self.recharges, strict=True):
            own = [each for each in pulses if each[1] == protocol.NOTHING]
            recharges += [(each[0], each[4], *each[5 : self._reported]) for each in own]
            told.append((answer, [each[: self._reported] for each in pulses if each not in own]))
        answer, pulses = self._same(told)
        self.said += answer
        return answer, pulses

    def feed(self, data, now_us):
        return self._told([each.feed(data, now_us) for each in self.boards])

    def advance(self, now_us):
        return self._told([each.advance(now_us) for each in self.boards])

    def hang_up(self, now_us):
        for each in self.boards:
            each.hang_up(now_us)

    def switch(self, is_open):
        for each in self.boards:
            each.switch(is_open)

    def books(self):
        return self._same([{name: each.books()[name] for name in BOOKS} for each in self.boards])


def encode_lists(sequence, times, measure, switched, image, most_bytes):
    """Return the payload of a SEQUENCE that fits into one packet."""
    can = Capabilities(
        sequence.electrodes, "three-state" if switched else "weighted", 5.0, 1 << 16, 100.0, "",
        measures=measure, packet_bytes=most_bytes + OVERHEAD,
    )  # fmt: skip
    (part,) = encode_scan(sequence, times, can, image)
    return part.payload


class Talk:
    """Host that sends single packets to a board and reads the answers."""

    def __init__(self, board, half=0x5EED):
        self.board, self.now_us = board, 0
        self.half = half

    def begin(self, limits=None, image=None):
        """Begin a session, and send limits and kernels if they are given."""
        self.half += 1
        self.host = LinkSession(lambda message: None, lambda: self.half)
        self.say(MessageKind.HELLO)
        self.say(MessageKind.BEGIN)
        if limits is not None:
            self.say(MessageKind.LIMITS, payload=encode_limits(limits))
        if image is not None:
            self.give(image)
        return self

    def give(self, image: KernelImage):
        at = 0
        while at < len(image.data):
            piece = image.data[at : at + 4096]
            head = protocol.KERNELS.pack(image.identity, len(image.data), at)
            self.say(MessageKind.KERNELS, payload=head + piece)
            at += len(piece)

    def say(self, kind, about=0, payload=b"", data=b""):
        """Send a packet, or the bytes of ``data``; return the answers as messages."""
        answer, self.pulses = self.board.feed(
            data or self.host.encode(kind, about, payload), self.now_us
        )
        return self.host.take(answer)

    def wait(self, time_us, step_us=5000):
        """Let time pass; return the messages that the board sends meanwhile."""
        heard, pulses, end_us = [], [], self.now_us + time_us
        while self.now_us < end_us:
            self.now_us = min(end_us, self.now_us + step_us)
            answer, new = self.board.advance(self.now_us)
            heard += self.host.take(answer)
            pulses += new
        self.pulses = pulses
        return heard

    def send(self, sequence, number, times=1, image=None, switched=False, measure=False):
        payload = encode_lists(sequence, times, measure, switched, image, 1 << 20)
        return self.say(MessageKind.SEQUENCE, number, payload)
