"""Time from a frame to the bytes for a board, compared with a minimal chain in OpenCV and NumPy.

Times depend on the computer. Both chains take turns in one run, so that they can be compared.
"""

import statistics
import time

import cv2
import numpy as np
import pytest

from firmware.tests.core_and_emulator import encode_lists
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
    """Return the default profile with side x side electrodes over the same field of view."""
    profile = load_profile("electric-mouse")
    table = profile.model_dump()
    table["array"] |= {"rows": side, "columns": side}
    table["optics"]["magnification"] *= side / 8
    return type(profile).model_validate(table)


def balanced_weights(side):
    """Return kernels of the right shape; their values do not affect the time."""
    count = side * side
    weights = np.full((count, count), 1 / (count - 1), np.float32)
    np.fill_diagonal(weights, -1)
    return weights


def letter(height, width, right=0.0, down=0.0):
    """Draw a letter in 640 x 480 pixels, shift it by ``right`` and ``down``, scale the image."""
    image = np.full((480, 640), 225, np.uint8)
    cv2.putText(image, "R", (130, 430), cv2.FONT_HERSHEY_SIMPLEX, 17, 35, 60)
    moved = np.array([[1, 0, right], [0, 1, down]], np.float32)
    image = cv2.warpAffine(image, moved, (640, 480), borderValue=225)
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


def strokes(height, width, count):
    """Return different images of a letter that moves through the field of view."""
    random = np.random.default_rng(0)
    places = np.linspace(-320, 320, count)
    return [letter(height, width, each, random.uniform(-20, 20)) for each in places]


class Ours:
    """Pipeline, safety gate and encoding, as in a run to a board that stores kernels."""

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
    """Minimal chain in OpenCV and NumPy: it limits single currents, without proof and checksum."""

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
            raise ValueError("a current exceeds the limit of 5,000 µA")
        return currents.tobytes()


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("side", "shape", "frames"),
    [(8, (64, 64), 600), (8, (480, 640), 300), (16, (64, 64), 300), (32, (64, 64), 60)],
)
def test_default_path(row, make_bank, quick, side, shape, frames):
    """Each frame differs, so no chain can reuse results of the frame before."""
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
        "Time from frame to bytes, `--scan auto`, to a board that stores kernels, µs",
        {
            "electrodes": f"{side * side:,}",
            "frame": f"{shape[1]} × {shape[0]}",
            "SmartTouch by itself: p50": f"{np.median(alone):,.0f}",
            "p99": f"{np.quantile(alone, 0.99):,.0f}",
            "minimum": f"{min(alone):,.0f}",
            "SmartTouch, taking turns: p50": f"{each[0]:,.0f}",
            "minimal chain, taking turns: p50": f"{each[1]:,.0f}",
            "ratio of the two": f"{each[0] / each[1]:.1f}",
        },
    )


def in_turn(chains, rounds):
    """Return the times of chains that take turns, µs, without the first call of each chain."""
    took = {name: [] for name in chains}
    for turn in range(rounds + 1):
        for name, chain in chains.items():
            start = time.perf_counter_ns()
            chain()
            if turn:
                took[name].append((time.perf_counter_ns() - start) / 1000)
    return took
