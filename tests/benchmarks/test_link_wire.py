"""Bytes of a sequence as currents and as lists of kernels, what wires make of them,
and the same µA at both ends and in C.

Run with::

    pytest tests/benchmarks/test_link_wire.py --benchmark-only -n0

Rates over wires are computed from bytes: 10 bit times a byte at 921,600 Bd, and 1 MB/s. A sequence
goes over the wire while the one before is scanned, so that the slower of the two counts.
"""

import re
import statistics
import subprocess
import time
from functools import partial

import numpy as np
import pytest

from smarttouch.boards.link.protocol import MessageKind, encode
from smarttouch.boards.link.sequence_encoding import KernelImage
from smarttouch.boards.open import make_board
from smarttouch.emulator.link_packets import rounded
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.profile.device import Output
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.sources.source_contract import Stimulus
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelLists, KernelTable, ScanSequence, quantized
from tests.benchmarks.test_link_latency import Bare, acknowledged_s, beside, limits_of, raised
from tests.boards.payloads import encode_lists
from tests.firmware.build import built, host, library
from tests.firmware.rig import Core, Talk
from tests.firmware.scenes import random_lists, random_table, sequence_of

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


def lists_at(electrodes, step, table, rng):
    kernel = rng.permutation(electrodes).astype(np.uint16)
    amplitude = np.full(electrodes, 40, np.uint16)
    lists = KernelLists(table, np.arange(electrodes + 1), kernel, amplitude)
    column = np.ones(electrodes, np.uint16)
    return ScanSequence(
        lists.current_ua(), 5 * column, 20 * column, lists.site, 40 * electrodes + 6000, 1.0,
        step * 10**9, sums=lists,
    )  # fmt: skip


def sent_at(times, write, *given, **named):
    times.append(time.perf_counter())
    return write(*given, **named)


@pytest.mark.parametrize("board", ["emulator", "C"])
@pytest.mark.parametrize("electrodes", [64, 128, 256, 512])
def test_acknowledged_over_a_pseudo_terminal(row, quick, electrodes, board):
    if quick and electrodes > 64:
        pytest.skip("smaller ones are every path")
    rng = np.random.default_rng(0)
    table = random_table(rng, electrodes, electrodes)
    image = KernelImage.of(table, 1 << 23, 4096)
    limits, output = limits_of(electrodes), Output(kind="weighted")
    length = packets(lists_at(electrodes, 1, table, rng), image)[1]
    bare, ours, plain = Bare(length), [], []
    process = None
    if board == "C":
        process = subprocess.Popen(
            [host(), f"--electrodes={electrodes}"], stdout=subprocess.PIPE, text=True
        )
        driver = make_board(f"link:{process.stdout.readline().strip()}", limits, output)
    else:
        driver = make_board("emulator:", limits, output)
    with driver:
        driver.keep_kernels(table)
        first = raised(driver, electrodes)
        at, wire = [], []
        carrier = driver.driver._packets
        carrier.send = partial(sent_at, at, carrier.send)
        for step in range(first, first + (3 if quick else 60)):
            ours.append(acknowledged_s(driver, lists_at(electrodes, step, table, rng)))
            wire.append(time.perf_counter() - at[-1])
            start = time.perf_counter()
            bare()
            plain.append(time.perf_counter() - start)
        assert driver.report().violations == 0
    bare.close()
    if process is not None:
        process.kill()
        process.wait()
        process.stdout.close()
    row(
        "A list in hand to acknowledged, beside its bare bytes",
        {
            "board": board,
            "electrodes": electrodes,
            **beside(length, ours, plain),
            # What a busy machine adds comes on top of these.
            "least": f"{1e6 * min(ours):.0f}",
            "least from the payload on": f"{1e6 * min(wire):.0f}",
            "least bare": f"{1e6 * min(plain):.0f}",
            "ratio of the last two": f"{min(wire) / min(plain):.1f}",
        },
    )


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


def test_the_same_currents_everywhere(row, quick):
    """A million lists: the host's, the emulator's and the C core's whole numbers."""
    count, electrodes, slots = (2_000 if quick else 1_000_000), 16, 60
    rng = np.random.default_rng(0)
    limits = SafetyLimits(electrodes, 5.0, 200, 0.5, 200, 0.8, 0.5, 5.0, total_ma=10.0)
    core = Core(library(), electrodes, ramp_ms=0)
    table = random_table(rng, 4000, electrodes)
    image = KernelImage.of(table, 1 << 23, 4096)
    talk = Talk(core).begin(limits, image)
    compared = number = pairs = 0
    while compared < count:
        lists = random_lists(rng, table, slots, most=8, loud=8000)
        number += 1
        talk.send(sequence_of(lists, period_us=100_000), number, image=image)
        pulses = talk.pulses
        talk.wait(9_100, 9_100)
        pulses += talk.pulses
        talk.say(MessageKind.HEARTBEAT)
        talk.wait(91_000, 91_000)
        talk.say(MessageKind.HEARTBEAT)
        wanted = lists.current_ua()
        assert [each[5] for each in pulses] == wanted.tolist()
        for slot in range(slots):
            own = slice(lists.first[slot], lists.first[slot + 1])
            every = table.weights[lists.kernel[own]].astype(int) * lists.amplitude[own, None]
            np.testing.assert_array_equal(rounded(every.sum(axis=0)), wanted[slot])
        compared += slots
        pairs += len(lists.kernel)
    books = core.books()
    assert (books["slots"], books["violations"]) == (compared, 0)
    core.close()
    row(
        "Lists of (kernel, amplitude): host, emulator and C core",
        {"lists": compared, "pairs": pairs, "electrodes": electrodes, "differ": 0},
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
