"""Size of a sequence as currents and as lists of kernels, and sequence rates over wires.

Rates are computed from sizes: a byte takes 10 bit times at 921,600 Bd, or 1 µs at 1 MB/s. A
sequence is sent while the board scans the previous one, so the longer time limits the rate.
"""

import re
import subprocess

import numpy as np
import pytest

from firmware.tests.builds_and_machines import built
from firmware.tests.core_and_emulator import encode_lists
from smarttouch.boards.link import Message, MessageKind, encode
from smarttouch.boards.link.sequence_encoding import KernelImage
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.sources.source_contract import Stimulus

WIRES = {"1 MB/s": 1e6, "921,600 Bd": 92_160}
PULSE_US, REST_US = 200, 100


def packets(sequence, image):
    """Return the size of a sequence in bytes, sent as currents and sent as lists of kernels."""
    payloads = (encode_lists(sequence, 1, True, False, each, 1 << 24) for each in (None, image))
    return [
        len(encode(Message(MessageKind.SEQUENCE, 1, 1 << 63 | 1 << 31, 1, 1, each)))
        for each in payloads
    ]


@pytest.mark.parametrize("scan", ["points", "auto"])
def test_frames_of_the_electric_mouse(row, quick, scan):
    profile = load_profile("electric-mouse")
    bank = load_bank(profile)
    pipeline = Pipeline(profile, bank, RunConfig(scan=scan), in_sums=True)
    image = KernelImage.of(pipeline.table, 1 << 23, 4096)
    for count in (20, 64):
        active = np.zeros((3, 64), np.float32)
        active[0, np.random.default_rng(1).permutation(64)[:count]] = 0.8
        sequence = pipeline.process(Stimulus(active, 10**9 * count, 5.0)).sequence
        sequence = pipeline.process(Stimulus(active, 10**9 * (count + 1), 5.0)).sequence
        plain, listed = packets(sequence, image)
        # Assume the fastest scan, in which slots follow each other without a pause.
        scan_s = sequence.slots * (PULSE_US + REST_US) / 1e6
        cells = {"scan": scan, "points": count, "slots": sequence.slots}
        cells |= {"bytes as currents": plain, "bytes as lists": listed}
        for wire, rate in WIRES.items():
            for form, size in (("currents", plain), ("lists", listed)):
                cells[f"{form}: Hz at {wire}"] = f"{1 / max(size / rate, scan_s):.1f}"
        row("Size and rate of sequences on the wire, as currents and as lists of kernels", cells)
        assert scan != "points" or count < 64 or plain / listed >= 25


def test_instructions_on_a_cortex_m3(row):
    image = built("measure", "st_measure.elf", "arm-none-eabi-gcc", "qemu-system-arm")
    firmware = built("qemu", "st_m3.elf", "arm-none-eabi-gcc", "qemu-system-arm")
    size = subprocess.run(["arm-none-eabi-size", firmware], capture_output=True, text=True)
    code = int(size.stdout.splitlines()[1].split()[0])
    command = ["qemu-system-arm", "-M", "mps2-an385", "-kernel", image, "-display", "none",
               "-monitor", "none", "-serial", "stdio", "-serial", "null", "-icount", "shift=0",
               "-semihosting"]  # fmt: skip
    # The board also sends binary packets, between its lines of text.
    said = subprocess.run(command, capture_output=True, timeout=120).stdout.decode("latin-1")
    found = re.findall(r"kernels, deliver, check, sequence (\d+) (\d+) (\d+)", said)
    assert len(found) == 5
    for kernels, *counts in found:
        for what, instructions in zip(("deliver", "check"), counts, strict=True):
            row(
                "Instructions per slot on a Cortex-M3, -O2, 64 electrodes",
                {"task": what, "kernels": kernels, "instructions": instructions,
                 "slots/s at 100 MHz, one instruction a cycle": round(1e8 / int(instructions)),
                 "code of the firmware, bytes": code},
            )  # fmt: skip
