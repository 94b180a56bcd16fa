"""Time from a frame to bytes, beside the same chain written the plain way.

Each figure is a time on the machine at hand; both chains take turns in one run.
"""

import statistics
import time

import cv2
import numpy as np
import pytest

from firmware.tests.rig import encode_lists
from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.wire.framing import LARGEST_PACKET
from smarttouch.boards.link import MessageKind
from smarttouch.boards.link.link_driver import LinkSession
from smarttouch.boards.link.sequence_encoding import KernelImage
from smarttouch.physiology.activating_function import af_matrix, targets
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.sources.source_contract import Frame, Pose
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import SlotPolicy

FULL_NS = 10**9


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
    """Pipeline, safety and wire format, as the loop runs them for a board that keeps kernels."""

    def __init__(self, profile, bank, images, sharing):
        self.images = images
        self.count = 0
        config = RunConfig(mode=Mode.RA, rate_hz=1.0, scan=sharing)
        self.pipeline = Pipeline(profile, bank, config, in_sums=True)
        self.image = KernelImage.of(self.pipeline.table, 1 << 23, 4096)
        self.gate = SafetyGate(SafetyLimits.of(profile))
        self.session = LinkSession(None)
        self()

    def __call__(self):
        image = self.images[self.count % len(self.images)]
        if self.count % 1000 == 0:
            self.gate.begin_session()
            self.pipeline.restart_at_zero()
        frame = Frame(image, self.count * FULL_NS, Pose(0, 0), 1.0)
        self.count += 1
        sequence = self.gate.check(self.pipeline.process(frame).sequence)
        payload = encode_lists(sequence, 1, False, False, self.image, LARGEST_PACKET)
        return self.session.encode(MessageKind.SEQUENCE, 1, payload)


class Plain:
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


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("side", "shape", "frames"),
    [(8, (64, 64), 600), (8, (480, 640), 300), (16, (64, 64), 300), (32, (64, 64), 60)],
)
def test_default_path(row, make_bank, quick, side, shape, frames):
    """`auto` for a board that keeps kernels, images that all differ, beside a plain chain."""
    frames = 3 if quick else frames
    profile, weights = grid_profile(side), balanced_weights(side)
    bank = make_bank(weights, af_matrix(profile, targets(profile, Afferent.RA)))
    images, others = (strokes(*shape, 2 * frames)[first::2] for first in (0, 1))
    ours = Ours(profile, bank, images, SlotPolicy((Afferent.RA,)))
    vectorized = Plain(side, images)
    assert len(ours()) > 10
    assert len(vectorized()) % (2 * side * side) == 0
    took = in_turn({"ours": ours, "vectorized": vectorized}, frames)
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
        },
    )


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
