"""How long a frame takes to become bytes, beside the same chain written the plain way.

Run with::

    pytest tests/benchmarks --benchmark-only --benchmark-columns=median,iqr,rounds

Each figure is a time on the machine at hand; the ratio that counts is printed by
`test_ratio`, from one run with both chains in turn.
"""

import statistics
import time

import cv2
import numpy as np
import pytest
from skimage.filters import threshold_sauvola
from skimage.transform import resize

from smarttouch.boards.link_protocol import Kind
from smarttouch.boards.link_sequence import encode_sequence
from smarttouch.boards.link_session import HostSession
from smarttouch.pipeline import Pipeline
from smarttouch.primary import Primary
from smarttouch.profile import load_profile
from smarttouch.scan.safety import SafetyGate, SafetyLimits
from smarttouch.sensing.frame import Frame, Pose

FULL_NS = 10**9


def grid_profile(side):
    """The default profile with side x side electrodes over the same skin."""
    profile = load_profile("electric-mouse")
    table = profile.model_dump()
    pitch = 16.0 / side
    table["array"] |= {"rows": side, "columns": side, "pitch_x_mm": pitch, "pitch_y_mm": pitch}
    table["array"]["diameter_mm"] = pitch / 2
    return type(profile).model_validate(table)


def balanced_weights(side):
    """Kernels of the right shape: their values do not change the time."""
    count = side * side
    weights = np.full((count, count), 1 / (count - 1), np.float32)
    np.fill_diagonal(weights, -1)
    return weights


def letter(height, width):
    """An upper case letter that fills most of the field."""
    image = np.full((480, 640), 225, np.uint8)
    cv2.putText(image, "R", (130, 430), cv2.FONT_HERSHEY_SIMPLEX, 17, 35, 60)
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


class Ours:
    """Pipeline, safety and wire format, as the loop runs them."""

    def __init__(self, side, image, bank):
        self.profile = grid_profile(side)
        self.image = image
        self.time_ns = 0
        self.pipeline = Pipeline(self.profile, bank, Primary.RA, 1.0)
        self.gate = SafetyGate(SafetyLimits.of(self.profile))
        self.session = HostSession()
        self()

    def __call__(self):
        frame = Frame(self.image, self.time_ns, Pose(0, 0), 1.0)
        self.time_ns += FULL_NS
        sequence = self.pipeline.process(frame).sequence
        self.gate.prove(sequence)
        payload = encode_sequence(
            "weighted",
            sequence.period_us,
            sequence.width_us,
            sequence.discharge_us,
            sequence.site,
            sequence.current_ua,
        )
        return self.session.encode(Kind.SEQUENCE, 1, payload)


class Plain:
    """The same, written as one first writes it."""

    def __init__(self, side, image):
        self.profile = grid_profile(side)
        self.image = image
        self.side = side
        self.weights = balanced_weights(side)

    def __call__(self):
        ink = self.image < threshold_sauvola(self.image, 25, k=0.34)
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


CASES = [
    pytest.param(8, (64, 64), id="64 electrodes, 64x64 patch"),
    pytest.param(8, (480, 640), id="64 electrodes, 640x480 frame"),
    pytest.param(32, (64, 64), id="1024 electrodes, 64x64 patch"),
    pytest.param(32, (480, 640), id="1024 electrodes, 640x480 frame"),
]


@pytest.mark.parametrize(("side", "shape"), CASES)
def test_ours(benchmark, make_bank, side, shape):
    weights = balanced_weights(side)
    assert len(benchmark(Ours(side, letter(*shape), make_bank(weights, weights)))) > 0


@pytest.mark.parametrize(("side", "shape"), CASES)
def test_ratio(benchmark, make_bank, side, shape, capsys):
    image, weights = letter(*shape), balanced_weights(side)
    ours, plain = Ours(side, image, make_bank(weights, weights)), Plain(side, image)
    plain()
    times = {ours: [], plain: []}
    for _ in range(15):
        for chain in (ours, plain):
            start = time.perf_counter()
            chain()
            times[chain].append(time.perf_counter() - start)
    ratio = statistics.median(p / o for o, p in zip(times[ours], times[plain], strict=True))
    benchmark.extra_info["plain over ours"] = round(ratio, 1)
    with capsys.disabled():
        print(
            f"\n{side * side} electrodes from {shape[1]}x{shape[0]}: ours "
            f"{statistics.median(times[ours]) * 1e6:.0f} µs, plain "
            f"{statistics.median(times[plain]) * 1e6:.0f} µs, ratio {ratio:.0f}"
        )
    benchmark.pedantic(ours, rounds=1)
