"""Bytes of a sequence as currents and as lists of kernels, and what wires make of them.

Run with::

    pytest tests/benchmarks/test_link_wire.py --benchmark-only -n0

Rates over wires are computed from bytes: 10 bit times a byte at 921,600 Bd, and 1 MB/s. A sequence
goes over the wire while the one before is scanned, so that the slower of the two counts.
"""

import re
import statistics
import subprocess
import time

import numpy as np
import pytest

from smarttouch.boards.link.protocol import MessageKind, encode
from smarttouch.boards.link.sequence_encoding import KernelImage
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.sources.source_contract import Stimulus
from smarttouch.stimulation.scan_sequence import KernelLists, KernelTable, quantized
from tests.benchmarks.test_link_latency import limits_of
from tests.boards.payloads import encode_lists
from tests.firmware.build import built, library
from tests.firmware.rig import Core, Talk
from tests.firmware.scenes import random_table, sequence_of

WIRES = {"1 MB/s": 1e6, "921,600 Bd": 92_160}
PULSE_US, REST_US = 200, 100


def packets(sequence, image):
    """Return the bytes of a sequence on the wire, as currents and as lists of kernels."""
    payloads = (encode_lists(sequence, 1, True, False, each, 1 << 24) for each in (None, image))
    return [
        len(encode(MessageKind.SEQUENCE, 1 << 63 | 1 << 31, 1, 1, 1, each)) for each in payloads
    ]


def tell(row, name, scan, points, sequence, image):
    plain, listed = packets(sequence, image)
    # Of a scan that goes as fast as its slots allow.
    scan_s = sequence.slots * (PULSE_US + REST_US) / 1e6
    cells = {"electrodes": name, "scan": scan, "points": points, "slots": sequence.slots,
             "bytes of currents": plain, "bytes of lists": listed,
             "fewer": f"{plain / listed:.1f}"}  # fmt: skip
    for wire, rate in WIRES.items():
        for form, size in (("currents", plain), ("lists", listed)):
            cells[f"{form}: a second at {wire}"] = f"{1 / max(size / rate, scan_s):.1f}"
    row("A sequence on the wire", cells)
    return plain / listed, 1 / max(listed / 1e6, scan_s)


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
        fewer, _ = tell(row, 64, scan, count, sequence, image)
        assert scan != "points" or count < 64 or fewer >= 25


@pytest.mark.parametrize("electrodes", [64, 128, 256, 512, 1024])
def test_larger_arrays(row, quick, electrodes):
    """Kernels at random, every weight of which is there: designs for such arrays take hours."""
    if quick and electrodes > 128:
        pytest.skip("smaller ones are every path")
    rng = np.random.default_rng(electrodes)
    weights = rng.normal(size=(electrodes, electrodes))
    weights -= weights.mean(axis=1, keepdims=True)
    site = np.arange(electrodes, dtype=np.uint16)
    table = KernelTable(quantized(weights), site, {}, {})
    image = KernelImage.of(table, 1 << 23, 4096)
    for points in (60, electrodes):
        amplitude = rng.integers(400, 8000, points).astype(np.uint16)
        kernel = rng.permutation(electrodes)[:points].astype(np.uint16)
        for scan, share in (("points", 1), ("auto", 6)):
            first = np.append(np.arange(0, points, share), points)
            lists = KernelLists(table, first, kernel, amplitude // share)
            column = np.ones(len(first) - 1, np.uint16)
            times = {"width_us": PULSE_US * column, "discharge_us": REST_US * column,
                     "period_us": 400_000}  # fmt: skip
            sequence = sequence_of(lists, **times)
            fewer, rate_hz = tell(row, electrodes, scan, points, sequence, image)
            if scan == "points":
                assert fewer >= (25 if electrodes < 256 else 40)
                assert points > 60 or rate_hz >= 50
        plain = sequence_of(lists, **times, sums=None)
        tell(row, electrodes, "frame", points, plain, None)


@pytest.mark.parametrize("electrodes", [64, 128, 256, 512])
def test_processor_time(row, quick, electrodes):
    """What a list of 60 points costs the host, from proved to framed, and the C core to check."""
    rng = np.random.default_rng(0)
    table = random_table(rng, electrodes, electrodes)
    image = KernelImage.of(table, 1 << 23, 4096)
    limits = limits_of(electrodes)
    core = Core(library(), electrodes, ramp_ms=0)
    talk = Talk(core).begin(limits, image)
    encoded, plain, checked = [], [], []
    for number in range(1, 5 if quick else 100):
        kernel = rng.permutation(electrodes)[:60].astype(np.uint16)
        amplitude = rng.integers(20, 120, 60).astype(np.uint16)
        lists = KernelLists(table, np.arange(61), kernel, amplitude)
        sequence = sequence_of(lists, period_us=40_000)
        start = time.process_time()
        packet = talk.host.encode(
            MessageKind.SEQUENCE, number, encode_lists(sequence, 1, False, False, image, 1 << 20)
        )
        between = time.process_time()
        talk.say(None, data=packet)
        checked.append(time.process_time() - between)
        encoded.append(between - start)
        start = time.process_time()
        encode(
            MessageKind.SEQUENCE, 1, 1, 1, 1, encode_lists(sequence, 1, True, False, None, 1 << 24)
        )
        plain.append(time.process_time() - start)
        talk.wait(41_000, 20_000)
        talk.say(MessageKind.HEARTBEAT)
    assert core.books()["violations"] == 0
    core.close()
    row(
        "Processor time of a list of 60 points, µs",
        {
            "electrodes": electrodes,
            "checked and encoded, as lists": f"{1e6 * statistics.median(encoded):.0f}",
            "encoded, as currents": f"{1e6 * statistics.median(plain):.0f}",
            "C core on this machine, with its check": f"{1e6 * statistics.median(checked):.0f}",
        },
    )


def test_instructions_on_a_cortex_m3(row):
    image = built("measure", "st_measure.elf", "arm-none-eabi-gcc", "qemu-system-arm")
    firmware = built("qemu", "st_m3.elf", "arm-none-eabi-gcc", "qemu-system-arm")
    size = subprocess.run(["arm-none-eabi-size", firmware], capture_output=True, text=True)
    code = int(size.stdout.splitlines()[1].split()[0])
    command = ["qemu-system-arm", "-M", "mps2-an385", "-kernel", image, "-display", "none",
               "-monitor", "none", "-serial", "stdio", "-serial", "null", "-icount", "shift=0",
               "-semihosting"]  # fmt: skip
    # Packets of the board are between its lines of text.
    said = subprocess.run(command, capture_output=True, timeout=120).stdout.decode("latin-1")
    found = re.findall(r"kernels, deliver, check, sequence (\d+) (\d+) (\d+)", said)
    assert len(found) == 5
    for kernels, *counts in found:
        for what, instructions in zip(("deliver", "check"), counts, strict=True):
            row(
                "Instructions of a slot on a Cortex-M3, -O2, 64 electrodes",
                {"what": what, "kernels": kernels, "instructions": instructions,
                 "slots a second at 100 MHz, one a cycle": round(1e8 / int(instructions)),
                 "code of the image, bytes": code},
            )  # fmt: skip
