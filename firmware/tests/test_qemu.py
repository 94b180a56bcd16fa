"""The firmware on processors emulated by QEMU.

A Cortex-M3 must deliver what it receives, and go to zero at the host timeout. For the STM32F405
of a kit, a model of shift registers and D/A converter derives currents from register writes.
"""

import contextlib
import re
import struct
import subprocess
import time
from dataclasses import dataclass, field

import numpy as np
import pytest

from firmware.tests.builds_and_machines import ELECTRODES, Machine, built
from firmware.tests.core_and_emulator import Talk, encode_lists
from smarttouch.boards.link import MessageKind, Refusal
from smarttouch.boards.link.sequence_encoding import encode_limits
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence
from tests.support.processes import PROGRAM, Forked
from tests.support.runs import until

pytestmark = pytest.mark.long  # QEMU is slow
LIMITS = SafetyLimits(ELECTRODES, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.4)


def scan(level_ua, intensity):
    """Return a scan of four slots, from one electrode to another."""
    current = np.zeros((4, ELECTRODES), np.int16)
    current[:, :2] = level_ua, -level_ua
    column = np.ones(4, np.uint16)
    return ScanSequence(current, 100 * column, 50 * column, 0 * column, 10_000, intensity, 0)


@pytest.mark.realtime
def test_noise_is_nothing_and_silence_is_zero_within_100_ms(start_cortex_m3):
    machine, rng = start_cortex_m3(counts=True), np.random.default_rng(0)
    with machine.connected() as board:
        board.line.sendall(rng.bytes(5000) + b"\0")
        talk, sequence = Talk(board), scan(300, 0.25)
        # On a busy machine the host can be silent for 100 ms before the sequence: then try again.
        for _ in range(20):
            talk.begin(LIMITS)
            # The host sends nothing after this sequence.
            talk.send(sequence, 1, times=1000)
            time.sleep(0.6)
            if len(told := machine.pulses()):
                break
    assert len(told) >= 4
    np.testing.assert_array_equal(
        told["current_ua"], np.tile(sequence.current_ua[0], (len(told), 1))
    )
    assert (told["width_us"] == 100).all()
    # Within a sequence, a slot begins after width and discharge of the slot before it.
    same = told["number"][1:] == told["number"][:-1]
    start_us = told["start_us"].astype(np.int64)
    assert (np.diff(start_us)[same] >= 150).all()
    # This sequence is the host's last message, so all pulses begin within the host timeout.
    assert np.ptp(start_us) <= 100_000


def test_a_board_that_stands_still_is_reset(start_cortex_m3):
    """The watchdog timer restarts the board, with all electrodes shorted and no session."""
    machine = start_cortex_m3(stands_after=5, counts=True)

    def starts():
        records = machine.records()
        return np.flatnonzero(records["number"] == int.from_bytes(b"star", "little"))

    with machine.connected() as board:
        talk = Talk(board).begin(LIMITS)
        # The board hangs in the first sequence; after the reset it does not know the session.
        board.line.settimeout(1)
        for number in (1, 2):
            with contextlib.suppress(TimeoutError):
                talk.send(scan(30, 0.1), number, times=1000)
            until(lambda: len(starts()) > 1)
        time.sleep(0.1)
    second = starts()[1]
    width_us = machine.records()["width_us"]
    assert (width_us[:second] > 0).sum() == 5
    assert (width_us[second:] == 0).all()


_WRITE = re.compile(r"addr (0x[0-9a-f]+) value (0x[0-9a-f]+) size \d name")
GPIOA_BSRR, GPIOB_BSRR = 0x40020018, 0x40020418
SPI1_DR, SPI2_CR1, SPI2_DR = 0x4001300C, 0x40003800, 0x4000380C
SILENT_US = 0x40023000
TIM4_CR1, TIM4_ARR = 0x40000800, 0x4000082C
LE, POL, SELECT = 4, 7, 12


@dataclass
class ShiftRegisters:
    """Model of an HV507 or HV513 (SPI 1, LE, POL, and BL from a timer) and an AD5452 (SPI 2).

    The shift register follows the table in KajiLabHV507B.h: BL low with POL high puts all outputs
    at ground; POL low inverts them. The D/A converter reads two zeros, 12 bits of counts and two
    unused bits, at falling clock edges (phase 1).

    `write` takes each write to a register of the processor. `wrong` describes forbidden states.
    """

    chain_bits: int = 64
    chain: list = field(default_factory=list)
    """Bits in the order in which they were shifted in."""
    latched: tuple = ()
    levels: dict = field(default_factory=dict)
    edges: dict = field(default_factory=lambda: {LE: 0, POL: 0, SELECT: 0, "clock": 0, "BL": 0})
    counts: int = 0
    word: int | None = None
    phase: int = 0
    width_us: int = 0
    high: bool = False
    """Whether BL is high, so that outputs follow the latches."""
    pulses: list = field(default_factory=list)
    """Output bits, counts and width of each pulse."""
    wrong: list = field(default_factory=list)
    zeros: list = field(default_factory=list)
    """For each shorting of all electrodes: number of pulses before it, and time, µs, since the last
    packet, as the board measures it."""

    def _pin(self, pin, level):
        if self.levels.get(pin) == level:
            return
        self.edges[pin] += 1
        self.levels[pin] = level
        if pin == LE and not level:
            self.latched = tuple(self.chain[-self.chain_bits :])
        if pin in (LE, POL) and self.high:
            self.wrong.append(f"pin {pin} changes within a pulse")
        if pin == SELECT and level and self.word is not None:
            self._convert(self.word)

    def _convert(self, word):
        if word >> 14 or not self.phase:
            self.wrong.append(f"the converter gets {word:#x} in phase {self.phase}")
        self.counts, self.word = word >> 2 & 0xFFF, None
        if self.counts and not self.high:
            self.wrong.append("current before BL is high")
        if self.counts and self.high:
            self.pulses.append((self.latched, self.counts, self.width_us))

    def _pins(self, value, pins):
        for pin in pins:
            if value >> pin & 1:
                self._pin(pin, 1)
            elif value >> (pin + 16) & 1:
                self._pin(pin, 0)

    def write(self, address, value):
        """Apply a write to a register of the processor."""
        if address == GPIOA_BSRR:
            self._pins(value, (LE,))
        elif address == GPIOB_BSRR:
            self._pins(value, (POL, SELECT))
        elif address == SPI1_DR:
            if self.high:
                self.wrong.append("bits are shifted within a pulse")
            self.chain = self.chain[-self.chain_bits :] + [
                value >> bit & 1 for bit in range(7, -1, -1)
            ]
            self.edges["clock"] += 16
        elif address == SPI2_DR:
            self.word = value
        elif address == SILENT_US:
            self.zeros.append((len(self.pulses), value))
        elif address == SPI2_CR1:
            self.phase = value & 1
        elif address == TIM4_ARR:
            self.width_us = value
        elif address == TIM4_CR1:
            high = bool(value & 1)
            if high and not value & 8:
                self.wrong.append("the timer does not end the pulse by itself")
            if high and self.levels.get(POL) != 1:
                self.wrong.append("a pulse with POL low")
            self.edges["BL"] += high != self.high
            self.high = high


SILENCE_US = 500_000
"""Host timeout of the board under QEMU, which is slow; `DriverContract` allows up to 600 ms."""


class F405(Machine):
    """Board of a kit, emulated by QEMU, with a trace of all register writes."""

    def __init__(self, folder, kit):
        more = f"-DST_QEMU -DST_KIT={kit} -DST_SILENCE_US={SILENCE_US}u"
        programs = "arm-none-eabi-gcc", "qemu-system-arm"
        elf = built("stm32", "st_f405.elf", *programs, more=more)
        trace = self._trace = folder / "trace.txt"
        super().__init__(
            "netduinoplus2", elf, lambda: trace.exists() and "0xcccc" in trace.read_text(),
            "-icount", "shift=3", "-trace", "memory_region_ops_write", "-D", trace,
        )  # fmt: skip

    def until_zero(self, least_us=0):
        """Wait until pulses were delivered, and all electrodes were shorted ``least_us`` or more
        after the last packet. Return the model of the registers."""
        for _ in range(600):
            model = self.registers()
            pulses, silent_us = model.zeros[-1] if model.zeros else (0, 0)
            if pulses == len(model.pulses) > 0 and silent_us >= least_us:
                break
            time.sleep(0.1)
        return model

    def registers(self):
        """Return the model after all register writes so far."""
        model = ShiftRegisters()
        with self._trace.open() as file:
            for line in file:
                if found := _WRITE.search(line):
                    model.write(int(found[1], 16), int(found[2], 16))
        return model


KITS = {"st_kajimoto61": (61, 2.442), "st_etactilekit64": (64, 9.99)}
"""Number of electrodes of each kit, and µA per count of its converter."""


@pytest.fixture
def start(tmp_path):
    started = []

    def start(kit):
        started.append(F405(tmp_path, kit))
        return started[-1]

    yield start
    for machine in started:
        machine.close()


class Host(Talk):
    """Host that waits for answers, however slow QEMU is."""

    def until(self, wanted, kind, about=0, payload=b""):
        """Repeat a packet until the board answers with the kind ``wanted``; return the answer."""
        for _ in range(20):
            answers = self.say(kind, about, payload)
            for _ in range(20):
                for each in answers:
                    if each.kind == wanted:
                        return each
                    # The board refuses packets that QEMU has delayed; the loop sends them again.
                    assert each.kind != MessageKind.NAK or each.payload[0] == Refusal.OLD, each
                answers = self.say(MessageKind.HEARTBEAT)
        raise AssertionError(f"the board sends no {wanted!r}")

    def account(self):
        """Return the numbers of slots, refused sequences, and sequences that execute or wait."""
        payload = self.until(MessageKind.REPORT, MessageKind.STATUS).payload
        return struct.unpack_from("<I", payload, 4)[0], payload[16], payload[32]


@pytest.mark.parametrize("kit", KITS)
def test_what_is_sent_is_what_registers_and_converter_get(start, kit):
    electrodes, ua_per_count = KITS[kit]
    machine = start(kit)
    limits = SafetyLimits(electrodes, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.4)
    rng, wanted, made = np.random.default_rng(0), [], 0
    with machine.connected() as board:
        talk = Host(board).begin()
        talk.until(MessageKind.LIMITED, MessageKind.LIMITS, payload=encode_limits(limits))
        for step in range(6):
            # The ramp begins at zero, so the first sequence has no current.
            slots, share = (10, 2 * step) if step else (0, 0)
            each, sign = rng.integers(0, electrodes, slots), rng.choice([1, -1], (slots, 1))
            rows = np.where(np.arange(electrodes) == each[:, None], sign, -sign)
            current = np.where(rows == sign, sign * share * (electrodes - 1), -sign * share)
            column = np.ones(slots, np.uint16)
            sequence = ScanSequence(current.astype(np.int16), 100 * column, 50 * column,
                                    0 * column, 50_000, 0.07 * step, 0)  # fmt: skip
            payload = encode_lists(sequence, 1, False, True, None, 8192)
            talk.until(MessageKind.ACK, MessageKind.SEQUENCE, step + 1, payload)
            wanted += [(row, share * (electrodes - 1)) for row in rows]
            busy = 1
            while busy:
                made, refused, busy = talk.account()
    model = machine.registers()
    assert (model.wrong, refused, made) == ([], 0, len(wanted))
    bits = np.array([pulse[0] for pulse in model.pulses], np.int8)[:, ::-1]
    # A set bit is an anode (−1), a cleared bit a cathode (1).
    np.testing.assert_array_equal(1 - 2 * bits[:, :electrodes], [row for row, _ in wanted])
    # Outputs without an electrode stay at ground.
    assert {bit for pulse in model.pulses for bit in pulse[0][: 64 - electrodes]} <= {0}
    asked = np.array([ua for _, ua in wanted])
    driven = np.array([counts for _, counts, _ in model.pulses]) * ua_per_count
    assert ((asked - ua_per_count < driven) & (driven <= asked)).all()
    assert {width for *_, width in model.pulses} == {100}
    # LE and BL have two edges for each pulse; LE and POL have one more at the beginning.
    assert model.edges["clock"] == 2 * 64 * made
    assert (model.edges[LE], model.edges["BL"], model.edges[POL]) == (2 * made + 1, 2 * made, 1)


def test_a_stop_ends_in_zero(start):
    """All electrodes are shorted within 1 ms after the last packet, by the board's clock."""
    machine, slots = start("st_kajimoto61"), 20
    limits = SafetyLimits(61, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.4)
    row = np.full((slots, 61), -5)
    row[:, 7] = 300
    column = np.ones(slots, np.uint16)
    sequence = ScanSequence(row.astype(np.int16), 50 * column, 50 * column, 0 * column, 10_000,
                            0.15, 0)  # fmt: skip
    with machine.connected() as board:
        talk = Host(board).begin()
        talk.until(MessageKind.LIMITED, MessageKind.LIMITS, payload=encode_limits(limits))
        payload = encode_lists(sequence, 1000, False, True, None, 8192)
        talk.until(MessageKind.ACK, MessageKind.SEQUENCE, 1, payload)
        while talk.account()[0] < 2 * slots:
            pass
        talk.until(MessageKind.STOPPED, MessageKind.STOP)
    model = machine.until_zero()
    pulses, silent_us = model.zeros[-1]
    assert model.wrong == []
    assert 2 * slots <= pulses == len(model.pulses) < 1000 * slots
    assert silent_us <= 1000
    assert len(machine.registers().pulses) == pulses


def test_a_killed_run_ends_in_zero(start, tmp_path):
    """All electrodes are shorted one host timeout after the last packet, by the board's clock."""
    machine = start("st_kajimoto61")
    command = [PROGRAM, "live", "--board", f"link:{machine.name}", "--profile",
               "kajimoto-61", "--force", "fixed:0.9", "--intensity", "0.3"]  # fmt: skip
    run = Forked(command, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    while not machine.registers().pulses:
        assert run.poll() is None
        time.sleep(0.1)
    run.kill()
    run.wait()
    model = machine.until_zero(SILENCE_US)
    pulses, silent_us = model.zeros[-1]
    assert model.wrong == []
    assert SILENCE_US <= silent_us <= SILENCE_US + 1000
    assert pulses == len(machine.registers().pulses)


def test_the_library_links_from_cpp():
    """The example is in C++, but must refer to functions of the core by their names in C."""
    object_file = built("arduino", "KitBoard.o", "c++")
    names = subprocess.run(["nm", object_file], capture_output=True, text=True, check=True).stdout
    assert {f"st_{name}" for name in ("init", "feed", "advance", "zero", "may_pulse")} <= {
        line.split()[-1] for line in names.splitlines() if " U " in line
    }
