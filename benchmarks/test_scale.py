"""Large arrays: what grows, and what of it is there."""

import numpy as np
import pytest

import smarttouch as st
from smarttouch.kernels.bank import design_bank
from smarttouch.running.config import RunConfig
from smarttouch.running.runner import Runner
from smarttouch.sources.source_contract import Frame, OpticalSource, Pose


def square(side, neighbors):
    """Return an electric mouse of another size, which sees as many pixels as it has electrodes."""
    mouse = st.load_profile("electric-mouse")
    sees = {"sensor_rows": side, "sensor_columns": side, "magnification": 0.4 * side}
    parts = {
        "array": {"rows": side, "columns": side},
        "skin": {"node_spacing_mm": 0.5},
        "kernels": {"neighbors": neighbors},
        "optics": sees,
    }
    return mouse.model_copy(
        update={name: getattr(mouse, name).model_copy(update=keys) for name, keys in parts.items()}
    )


class Specks(OpticalSource):
    """Frames in which one of 24 electrodes or so has a dark speck before it, without end."""

    def __init__(self, side):
        super().__init__("specks")
        dark = np.random.default_rng(1).random((8, side, side)) < 1 / 24
        self._images = np.where(dark, 20, 230).astype(np.uint8)
        self._number = 0

    def read(self, time_ns):
        self._number += 1
        image = self._images[self._number % len(self._images)]
        return Frame(image, time_ns, Pose(0, 0), 0.9, number=self._number)


@pytest.fixture(scope="module")
def large(quick):
    side = 34 if quick else 64
    profile = square(side, 9 if quick else 64)
    return side, profile, design_bank(profile)


@pytest.mark.timeout(0)
@pytest.mark.parametrize("board", ["memory:", "emulator:"])
def test_a_large_array_runs(row, quick, large, board):
    side, profile, bank = large
    config = RunConfig(rate_hz=10.0, seconds=1.5 if quick else 20, intensity=0.8)
    with st.open_display(board, profile) as display:
        source = Specks(side)
        run = Runner(source, display, config, force="fixed:0.9", load_kernels=lambda _: bank)
        found = run.run().figures
    row(
        "Large arrays, RA, 10 sequences a second asked",
        {
            "electrodes": side * side,
            "board": board,
            "sequences a second": f"{found['rate_hz']:.1f}",
            "points": f"{found['slots'] / max(1, found['sequences']):.0f}",
            "own work, ms, p50 / p99": " / ".join(
                f"{found['work_us'][key] / 1000:.1f}" for key in ("p50", "p99")
            ),
            "dropped as too late": found["dropped_late"],
        },
    )
    assert found["slots"]
    # Nothing but the emulator counts violations.
    assert found["emulator_violations"] in (None, 0)
