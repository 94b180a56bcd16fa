"""Time from a frame to bytes, beside the same chain written the plain way.

Run with::

    pytest tests/benchmarks/test_frame_to_bytes.py --benchmark-only -n0

Each figure is a time on the machine at hand; both chains take turns in one run. `test_scans` has,
of frames that all differ, p50 and p99 by themselves and in turn with one another, and what a frame
allocates at once until it is proved, beside the size of its sequence.
"""

import statistics
import time
import tracemalloc

import cv2
import numpy as np
import pytest
from skimage.filters import threshold_sauvola
from skimage.transform import resize

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.wire.framing import LARGEST_PACKET
from smarttouch.boards.link.protocol import HostSession, MessageKind
from smarttouch.boards.link.sequence_encoding import KernelImage
from smarttouch.physiology.activating_function import af_matrix, targets
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.sources.source_contract import Frame, Pose
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import NO_SHARING, SlotPolicy
from tests.boards.payloads import encode_lists

FULL_NS = 10**9
SCANS = {
    "points": NO_SHARING,
    "auto": SlotPolicy((Afferent.RA,)),
}


def grid_profile(side):
    """The default profile with side x side of its electrodes, which see the same print."""
    profile = load_profile("electric-mouse")
    table = profile.model_dump()
    table["array"] |= {"rows": side, "columns": side}
    table["optics"]["magnification"] *= side / 8
    return type(profile).model_validate(table)


def balanced_weights(side):
    """Kernels of the right shape: their values do not change the time."""
    count = side * side
    weights = np.full((count, count), 1 / (count - 1), np.float32)
    np.fill_diagonal(weights, -1)
    return weights


def letter(height, width, right=0.0, down=0.0):
    """An upper case letter that fills most of the field, so many of 640 x 480 pixels moved."""
    image = np.full((480, 640), 225, np.uint8)
    cv2.putText(image, "R", (130, 430), cv2.FONT_HERSHEY_SIMPLEX, 17, 35, 60)
    moved = np.array([[1, 0, right], [0, 1, down]], np.float32)
    image = cv2.warpAffine(image, moved, (640, 480), borderValue=225)
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


def strokes(height, width, count):
    """The letter as it comes into the field and leaves it: so many images that all differ."""
    random = np.random.default_rng(0)
    places = np.linspace(-320, 320, count)
    return [letter(height, width, each, random.uniform(-20, 20)) for each in places]


class Ours:
    """Pipeline, safety and wire format, as the loop runs them.

    A board that keeps the kernels gets lists of these, another one currents.
    """

    def __init__(self, profile, bank, images, sharing=NO_SHARING, keeps=False):
        self.images = images
        self.count = 0
        config = RunConfig(mode=Mode.RA, rate_hz=1.0, scan=sharing)
        self.pipeline = Pipeline(profile, bank, config, in_sums=keeps)
        self.image = KernelImage.of(self.pipeline.table, 1 << 23, 4096) if keeps else None
        self.gate = SafetyGate(SafetyLimits.of(profile))
        self.session = HostSession()
        self()

    def proved(self):
        """Return what the gate lets through of the next frame."""
        image = self.images[self.count % len(self.images)]
        if self.count % 1000 == 0:
            self.gate.begin_session()
            self.pipeline.restart_softly()
        frame = Frame(image, self.count * FULL_NS, Pose(0, 0), 1.0)
        self.count += 1
        return self.gate.check(self.pipeline.process(frame).sequence)

    def __call__(self):
        sequence = self.proved()
        payload = encode_lists(sequence, 1, False, False, self.image, LARGEST_PACKET)
        return self.session.encode(MessageKind.SEQUENCE, 1, payload)


class Plain:
    """The same, written as one first writes it."""

    def __init__(self, side, images):
        self.images = images
        self.count = 0
        self.side = side
        self.weights = balanced_weights(side)

    def __call__(self):
        image = self.images[self.count % len(self.images)]
        self.count += 1
        ink = image < threshold_sauvola(image, 25, k=0.34)
        cells = resize(ink.astype(float), (self.side, self.side), anti_aliasing=True).ravel()
        packet = bytearray()
        for site, activation in enumerate(cells):
            if activation < 0.15:
                continue
            amplitude = 2400 * (0.5 + 0.5 * min(1.0, (activation - 0.15) / 0.35))
            currents = [round(amplitude * weight) for weight in self.weights[site]]
            currents[site] -= sum(currents)
            if max(abs(current) for current in currents) > 5000:
                raise ValueError("too strong")
            for current in currents:
                packet += int(current).to_bytes(2, "little", signed=True)
        return bytes(packet)


class Vectorized:
    """The same by OpenCV and numpy at once, as in an afternoon: no proof, no checksum, no limits
    but the strongest current."""

    def __init__(self, side, images):
        self.images, self.side, self.count = images, side, 0
        self.weights = balanced_weights(side)

    def __call__(self):
        image = self.images[self.count % len(self.images)]
        self.count += 1
        around = cv2.subtract(cv2.blur(image, (25, 25)), 40)
        ink = cv2.compare(image, around, cv2.CMP_LT)
        cells = cv2.resize(ink, (self.side, self.side), interpolation=cv2.INTER_AREA).ravel()
        site = np.flatnonzero(cells >= 0.15 * 255)
        amplitude = 1200 + 1200 * np.minimum(1, (cells[site] / 255 - 0.15) / 0.35)
        currents = np.rint(amplitude[:, None] * self.weights[site]).astype(np.int16)
        currents[np.arange(len(site)), site] -= currents.sum(axis=1, dtype=np.int16)
        if np.abs(currents).max(initial=0) > 5000:
            raise ValueError("too strong")
        return currents.tobytes()


CASES = [
    pytest.param(8, (64, 64), id="64 electrodes, 64x64 patch"),
    pytest.param(8, (480, 640), id="64 electrodes, 640x480 frame"),
    pytest.param(32, (64, 64), id="1024 electrodes, 64x64 patch"),
    pytest.param(32, (480, 640), id="1024 electrodes, 640x480 frame"),
]


@pytest.mark.parametrize("keeps", [False, True])
@pytest.mark.parametrize(("side", "shape"), CASES)
def test_ratio(row, make_bank, quick, side, shape, keeps):
    image, weights = letter(*shape), balanced_weights(side)
    ours = Ours(grid_profile(side), make_bank(weights, weights), [image], keeps=keeps)
    # Lists have four bytes a point.
    assert (len(ours()) < 10 * side * side) is keeps
    plain = Plain(side, [image])
    alone = in_turn({"ours": ours}, 5 if quick else 1000)["ours"]
    took = in_turn({"ours": ours, "plain": plain}, 2 if quick else 15)
    ratio = statistics.median(p / o for o, p in zip(took["ours"], took["plain"], strict=True))
    p50, p99 = quantiles(alone)
    row(
        "Points one by one beside the slow plain chain, µs",
        {
            "electrodes": f"{side * side:,}",
            "frame": f"{shape[1]} × {shape[0]}",
            "kernels kept": "yes" if keeps else "no",
            "p50": f"{p50:,.0f}",
            "p99": f"{p99:,.0f}",
            "in turn with the plain chain": f"{statistics.median(took['ours']):,.0f}",
            "the plain chain": f"{statistics.median(took['plain']):,.0f}",
            "over ours": f"{ratio:.0f}",
        },
    )


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("side", "shape", "frames"),
    [(8, (64, 64), 600), (8, (480, 640), 300), (16, (64, 64), 300), (32, (64, 64), 60)],
)
def test_default_path(row, make_bank, quick, side, shape, frames):
    """`auto` for a board that keeps kernels, images that all differ, beside both plain chains."""
    frames = 3 if quick else frames
    profile, weights = grid_profile(side), balanced_weights(side)
    bank = make_bank(weights, af_matrix(profile, targets(profile, Afferent.RA)))
    images, others = (strokes(*shape, 2 * frames)[first::2] for first in (0, 1))
    ours = Ours(profile, bank, images, SCANS["auto"], keeps=True)
    vectorized = Vectorized(side, images)
    assert len(ours()) > 10
    assert len(vectorized()) % (2 * side * side) == 0
    took = in_turn({"ours": ours, "vectorized": vectorized}, frames)
    slow = in_turn({"plain": Plain(side, images)}, max(2, frames // 30))["plain"]
    ours.images = others
    alone = in_turn({"ours": ours}, frames - 1)["ours"]
    each = [statistics.median(took[name]) for name in ("ours", "vectorized")]
    row(
        "Frame to bytes on the default path, `--scan auto` to a board that keeps kernels, µs",
        {
            "electrodes": f"{side * side:,}",
            "frame": f"{shape[1]} × {shape[0]}",
            "alone: p50": f"{np.median(alone):,.0f}",
            "p99": f"{np.quantile(alone, 0.99):,.0f}",
            "least": f"{min(alone):,.0f}",
            "in turn: ours": f"{each[0]:,.0f}",
            "vectorized plain chain": f"{each[1]:,.0f}",
            "ours over it": f"{each[0] / each[1]:.1f}",
            "slow plain chain": f"{statistics.median(slow):,.0f}",
        },
    )


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("side", "frames"), [(8, 600), (16, 200), (32, 40)])
def test_scans(row, make_bank, quick, side, frames):
    """Points one by one and kernels added up, in turn with the plain chain."""
    if quick:
        frames = 12 if side < 32 else 3
    profile, weights = grid_profile(side), balanced_weights(side)
    bank = make_bank(weights, af_matrix(profile, targets(profile, Afferent.RA)))
    # Half of them in turn and half alone.
    images, others = (strokes(64, 64, 2 * frames)[first::2] for first in (0, 1))
    plain = Plain(side, images)
    scans = {
        name: Ours(profile, bank, images, sharing)
        for name, sharing in SCANS.items()
        if name == "points" or not (quick and side == 32)
    }
    took = in_turn(scans, frames)
    plain_us = statistics.median(in_turn({"plain": plain}, max(2, frames // 20))["plain"])
    for name, chain in scans.items():
        at_once, size = allocated(chain)
        chain.images, chain.count = others, 0
        p50, p99 = quantiles(in_turn({name: chain}, frames - 1)[name])
        beside_p50, beside_p99 = quantiles(took[name])
        row(
            "Ways to scan, µs",
            {
                "electrodes": f"{side * side:,}",
                "scan": name,
                "p50": f"{p50:,.0f}",
                "p99": f"{p99:,.0f}",
                "in turn: p50": f"{beside_p50:,.0f}",
                "in turn: p99": f"{beside_p99:,.0f}",
                "allocated at once, KiB": f"{at_once / 1024:,.0f}",
                "sequence, KiB": f"{size / 1024:,.1f}",
                "the plain chain": f"{plain_us:,.0f}",
                "over ours": f"{plain_us / p50:,.1f}",
            },
        )


def quantiles(times):
    """Return the median and the 99th percentile."""
    return np.quantile(times, [0.5, 0.99])


def in_turn(chains, rounds):
    """Return the times of each chain, µs; their first calls are not counted."""
    took = {name: [] for name in chains}
    for turn in range(rounds + 1):
        for name, chain in chains.items():
            start = time.perf_counter_ns()
            chain()
            if turn:
                took[name].append((time.perf_counter_ns() - start) / 1000)
    return took


def allocated(chain):
    """Return the most bytes that a frame holds at once until it is proved, and its sequence's."""
    tracemalloc.start()
    try:
        chain.proved()
        before, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        sequence = chain.proved()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    arrays = (sequence.current_ua, sequence.width_us, sequence.discharge_us, sequence.site)
    return peak - before, sum(each.nbytes for each in arrays)
