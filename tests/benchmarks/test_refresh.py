"""Refresh of shared slots against point scan, by the books of an emulated board.

A table: run with ``--benchmark-only -n0``.
"""

import time

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.files import data_folder
from smarttouch.base.tactile_image import TactileImage
from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.imaging.tactile_mapper import TactileMapper
from smarttouch.kernels.bank import load_bank
from smarttouch.sources import open_source
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import SlotPolicy
from smarttouch.stimulation.scheduler import ScanScheduler, SchedulerContext
from tests.rising import open_level

from ..played import played
from .frame_sets import LETTERS, array_named, drawn, scattered

DENSITIES = (0.05, 0.10, 0.20, 0.40, 0.60)


def swept_page(profile, count):
    """Return activations of frames with ink, evenly over the sample page."""
    found, mapper = [], TactileMapper(profile)
    with open_source(f"page:{data_folder('sample_images') / 'page.png'}", profile) as sensor:
        for time_ns in range(10**9, 9 * 10**9, 40_000_000):
            frame = sensor.read(time_ns)
            if frame is None:
                break
            found.append(mapper.map(frame, Mode.RA).activation[Afferent.RA].copy())
    found = [each for each in found if np.count_nonzero(each) > 1]
    return [found[index] for index in np.linspace(0, len(found) - 1, count).astype(int)]


def delivered(profile, bank, afferent, frames, activations):
    """Return the board's slots, its own time in µs, proofs and the host's seconds a frame."""
    scan = ScanScheduler(
        profile, bank, (afferent,), profile.limits.rate_hz,
        common=SchedulerContext(SlotPolicy(frames)),
    )  # fmt: skip
    proofs, spent, period_us = [], 0.0, 0
    with played(profile, SimulatedDriver) as board:
        for index, activation in enumerate(activations):
            rows = np.zeros((3, len(activation)), np.float32)
            rows[afferent] = activation
            # Seconds between them: the soft start is over before the first counts.
            image = TactileImage(rows, (index + 1) * 10**9, 1.0)
            if not index:
                silent = scan.schedule(TactileImage(0 * rows, 0, 1.0), 0.0)
                open_level(board.send, silent, SafetyLimits.of(profile))
            start = time.perf_counter()
            sequence = scan.schedule(image, 1.0)
            spent += time.perf_counter() - start
            board.send(sequence)
            proofs.append(sequence.proof)
            period_us += sequence.period_us
        board.drain()
        report = board.report()
    assert report.violations == 0
    # One slot opened the level.
    pulse, slots = profile.pulse, report.slots - 1
    busy_us = slots * (pulse.width_us + pulse.discharge_us)
    return slots, busy_us, period_us, proofs, spent / len(activations)


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("afferent", [Afferent.RA])
@pytest.mark.parametrize("name", ["electric-mouse", "16x16", "optacon-24x6"])
def test_refresh_against_point_scan(row, quick, changed, name, afferent):
    profile = array_named(name, quick, changed)
    rows, columns = profile.array.rows, profile.array.columns
    if name[0].isdigit():
        # A printed line fills the rows, as on 8 x 8.
        keys = {"optics.sensor_rows": 8 * rows, "optics.sensor_columns": 8 * columns}
        profile = changed(profile, keys | {"optics.magnification": 0.4 * rows})
    bank = load_bank(profile)
    name, sites = profile.name, rows * columns
    sets = {"letters": [drawn(each, rows, columns) for each in ("T" if quick else LETTERS)]}
    for density in DENSITIES[:1] if quick else DENSITIES:
        points = round(density * sites)
        sets[f"{density:.0%}"] = [
            scattered(points, sites, seed) for seed in range(1 if quick else 16)
        ]
    sets["page"] = swept_page(profile, 2 if quick else 60 if sites < 1000 else 16)
    for kind, levels in sets.items():
        activations = [level.astype(np.float32) for level in levels]
        found = {
            way: delivered(profile, bank, afferent, frames, activations)
            for way, frames in (("points", ()), ("frames", (afferent,)))
        }
        count = len(activations)
        (slots, busy_us, period_us, _, host_s), (few, short_us, least_us, proofs, spent_s) = (
            found["points"],
            found["frames"],
        )
        shared = [each.shared for each in proofs if each.shared]
        each = [
            np.count_nonzero(level) / len(proof.points)
            for level, proof in zip(levels, proofs, strict=True)
        ]
        other, spill = (max(worst) for worst in zip(*shared, strict=True)) if shared else (0, 0)
        lonely = sum(
            int(((proof.points == 1) & (proof.off_target > 0.3)).sum()) for proof in proofs
        )
        assert few <= slots
        row(
            "Refresh of `auto` against `points`",
            {
                "array": f"{name}, {afferent.name}",
                "frames": f"{kind} ({count})",
                "points in slots": f"{slots / count:.1f} → {few / count:.1f}",
                "Hz": f"{1e6 * count / busy_us:.0f} → {1e6 * count / short_us:.0f}",
                "times (least)": f"{slots / few:.1f} ({min(each):.1f})",
                "within 200 Hz": f"{1e6 * count / period_us:.0f} → {1e6 * count / least_us:.0f}",
                "other": f"{other:.2f}",
                "spill": f"{spill:.2f}",
                "single points above .30": lonely,
                "planned in, ms": f"{1e3 * host_s:.1f} → {1e3 * spent_s:.1f}",
            },
        )
