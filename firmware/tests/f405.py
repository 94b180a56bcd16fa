"""A kit on an STM32F405 that QEMU plays, and a model of the registers that its pins go to."""

import re
import socket
import subprocess
import time
from dataclasses import dataclass, field

import numpy as np

from firmware.tests import build

_WRITE = re.compile(r"addr (0x[0-9a-f]+) value (0x[0-9a-f]+) size \d name")
GPIOA_BSRR, GPIOB_BSRR = 0x40020018, 0x40020418
SPI1_DR, SPI2_CR1, SPI2_DR = 0x4001300C, 0x40003800, 0x4000380C
SILENT_US = 0x40023000
TIM4_CR1, TIM4_ARR = 0x40000800, 0x4000082C
LE, POL, SELECT = 4, 7, 12


@dataclass
class ShiftRegisters:
    """HV507 or HV513 behind SPI 1, LE, POL and a timer's BL, and an AD5452 behind SPI 2.

    By the table of functions in KajiLabHV507B.h: BL low with POL high puts all outputs at ground;
    POL low inverts them. The AD5452 takes two zeros, counts and two bits that do not matter, at
    falling edges (phase 1).

    Every write to a register of the processor goes through `write`. What must never be is kept in
    `wrong`, a sentence each.
    """

    chain_bits: int = 64
    chain: list = field(default_factory=list)
    """Bits that were shifted in, the last ones last."""
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
    """Output bits, counts and width of each."""
    wrong: list = field(default_factory=list)
    zeros: list = field(default_factory=list)
    """Of each time that all electrodes were shorted: pulses until then, and µs since the last
    packet, by the board's clock."""

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
            self.wrong.append(f"the converter is told {word:#x} in phase {self.phase}")
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
        """Take a write to one of the processor's registers."""
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


class F405:
    """One machine, whose line is the socket of a port."""

    def __init__(self, folder, kit="st_kajimoto61"):
        more = f"-DST_QEMU -DST_KIT={kit} -DST_SILENCE_US={build.silence_ms}000u"
        programs = "arm-none-eabi-gcc", "qemu-system-arm"
        elf = build.built("stm32", "st_f405.elf", *programs, more=more)
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self._trace = folder / "trace.txt"
        command = ["qemu-system-arm", "-M", "netduinoplus2", "-kernel", elf, "-display", "none",
                   "-monitor", "none", "-icount", "shift=3", "-trace", "memory_region_ops_write",
                   "-D", self._trace,
                   "-serial", f"tcp:127.0.0.1:{self.port},server=on,wait=off,nodelay=on",
                   ]  # fmt: skip
        self.process = subprocess.Popen(command, start_new_session=True)
        for _ in range(6000):
            if self._trace.exists() and "0xcccc" in self._trace.read_text():
                break
            time.sleep(0.01)

    def close(self):
        self.process.kill()
        self.process.wait()

    def until_zero(self, least_us=0):
        """Wait until all electrodes are shorted after pulses and some silence; return the model."""
        for _ in range(600):
            model = self.registers()
            pulses, silent_us = model.zeros[-1] if model.zeros else (0, 0)
            if pulses == len(model.pulses) > 0 and silent_us >= least_us:
                break
            time.sleep(0.1)
        return model

    def registers(self):
        """Return the model, after all writes so far."""
        model = ShiftRegisters()
        with self._trace.open() as file:
            for line in file:
                if found := _WRITE.search(line):
                    model.write(int(found[1], 16), int(found[2], 16))
        return model


def states(model, electrodes):
    """Return the states of each pulse's electrodes, (N, E): −1 anode, 1 cathode."""
    bits = np.array([pulse[0] for pulse in model.pulses], np.int8)[:, ::-1]
    return 1 - 2 * bits[:, :electrodes]
