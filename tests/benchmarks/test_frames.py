"""Frames in one pulse: how near operators come to the optimum, slots per frame, what survives.

All are tables: run with ``--benchmark-only -n0``.
"""

import time

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.frame_fields import FrameBounds
from smarttouch.kernels.frame_operator import FrameOperator, Weights, keeps
from smarttouch.kernels.proved_sets import color_classes
from smarttouch.kernels.slot_plans import likely_slots, plan_slots
from smarttouch.stimulation.frame_slots import FrameSlots

from ..reference.joint_programme import joint_programme
from ..reference.spread import Worst, spread_judges, uneven_levels, with_gain_error
from .frame_sets import LETTERS, array_named, drawn, judge_of, scattered

FREE_MA = 50.0
SHOWN = [Afferent.RA, Afferent.SAI]


def counted(quick):
    """Return how many points random frames have, and how many frames there are."""
    return ((2, 2), (4, 2)) if quick else ((2, 25), (4, 75), (8, 50), (16, 50))


def median_and_95(found):
    return f"{np.median(found):.2f} ({np.quantile(found, 0.95, method='higher'):.2f})"


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("afferent", SHOWN)
def test_gap_to_the_optimum(row, quick, profile, bank, afferent):
    judge = judge_of(profile, afferent)
    ways = {
        "active only": FrameOperator(judge),
        "against others": FrameOperator(judge, Weights(1.0, 1.0, 0.01)),
        "least current": FrameOperator(judge, Weights(0.0, 0.0, 1.0)),
    }
    kernels = bank.kernels(afferent) * profile.full_ma[:, None]
    sets = {"letters": [drawn(each) for each in ("AT" if quick else LETTERS)]}
    for points, count in counted(quick):
        sets[f"{points} random"] = [scattered(points, 64, seed) for seed in range(count)]
    for name, levels in sets.items():
        found = {}
        for level in levels:
            active = np.flatnonzero(level)
            start = time.perf_counter()
            best = joint_programme(judge, level, FrameBounds(), None, np.full(64, FREE_MA))
            spent = {"optimum": time.perf_counter() - start}
            currents = {"optimum": best.current}
            for way, operator in ways.items():
                start = time.perf_counter()
                currents[way] = operator.currents(level)
                spent[way] = time.perf_counter() - start
            # One product for all frames, for which an inactive site requests 0.
            matrix = ways["active only"].independent(np.arange(len(level))).T
            wish = level * judge.wish_af
            start = time.perf_counter()
            currents["one matrix"] = matrix @ wish
            spent["one matrix"] = time.perf_counter() - start
            currents["superposed"] = level @ kernels
            mixed = judge.target[active] @ kernels[active].T
            currents["independent kernels"] = kernels[active].T @ np.linalg.solve(
                mixed, wish[active]
            )
            for way, current in currents.items():
                found.setdefault(way, []).append(
                    (judge.judge(current, level), best.optimum, spent.get(way, 0.0))
                )
        for way, each in found.items():
            other = np.array([figures.off_target for figures, _, _ in each])
            gap = other / [optimum for _, optimum, _ in each]
            row(
                "Currents of frames, beside the optimum of each",
                {
                    "class": afferent.name,
                    "frames": name,
                    "way": way,
                    "other (worst)": f"{other.mean():.3f} ({other.max():.3f})",
                    "of the optimum (95 %)": median_and_95(gap),
                    "spill": f"{max(figures.spill for figures, _, _ in each):.2f}",
                    "total, mA": f"{np.mean([figures.total_ma for figures, _, _ in each]):.1f}",
                    "ms": f"{1e3 * np.median([spent for _, _, spent in each]):.2f}",
                },
            )


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("afferent", SHOWN)
def test_gap_within_limits(row, quick, profile, afferent):
    """The operator comes near the joint optimum if that is what it is asked to keep."""
    judge = judge_of(profile, afferent)
    operator, limits = FrameOperator(judge), FrameBounds()
    for points, count in counted(quick):
        gaps, slow, fast, none = [], [], [], 0
        for seed in range(count):
            level = scattered(points, 64, seed)
            start = time.perf_counter()
            try:
                best = joint_programme(judge, level, limits, FREE_MA)
            except DesignError:
                none += 1
                continue
            slow.append(time.perf_counter() - start)
            gap = np.inf
            for part in (1.02, 1.05, 1.1, 1.2, 1.3, 1.5, 2.0, 3.0):
                bounds = FrameBounds(other=part * best.optimum)
                start = time.perf_counter()
                current, figures = operator.bounded(level, bounds, FREE_MA)
                fast.append(time.perf_counter() - start)
                if keeps(judge, figures, bounds, current, FREE_MA):
                    gap = part
                    break
            gaps.append(gap)
        if not gaps:
            continue
        row(
            "How near the optimum the operator can be kept",
            {
                "class": afferent.name,
                "random points": points,
                "frames (impossible)": f"{count} ({none})",
                "of the optimum (95 %)": median_and_95(gaps),
                "worst": f"{max(gaps):.2f}",
                "optimum, ms": f"{1e3 * np.median(slow):.0f}",
                "operator, ms": f"{1e3 * np.median(fast):.1f}",
            },
        )


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("afferent", SHOWN)
@pytest.mark.parametrize("name", ["electric-mouse", "optacon-24x6", "16x16", "32x32"])
def test_slots_per_frame(row, quick, changed, name, afferent):
    profile = array_named(name, quick, changed)
    name, rows, columns = profile.name, profile.array.rows, profile.array.columns
    judge, sites = judge_of(profile, afferent), rows * columns
    start = time.perf_counter()
    operator = FrameOperator(judge)
    setup = time.perf_counter() - start
    few = 4 if sites <= 256 else 1
    letters = [drawn(each, rows, columns) for each in LETTERS]
    sets = {"letters": letters[: 1 if quick else 26 if few > 1 else 4]}
    for density in (0.10,) if quick else (0.05, 0.10, 0.25, 0.60):
        points = round(density * sites)
        sets[f"{density:.0%}"] = [
            scattered(points, sites, seed) for seed in range(1 if quick else few)
        ]
    for total_ma, uneven in ((profile.limits.total_ma, 0.05), (FREE_MA, 0.05), (FREE_MA, 0.15)):
        bounds = FrameBounds(uneven=uneven)
        for kind, levels in sets.items():
            start = time.perf_counter()
            begin = [likely_slots(operator, level, bounds, total_ma) for level in levels]
            plans = [(level, plan_slots(operator, level, bounds, total_ma)) for level in levels]
            spent = (time.perf_counter() - start) / len(levels)
            ratio = [np.count_nonzero(level) / len(slots) for level, slots in plans]
            slots = [slot for _, each in plans for slot in each]
            row(
                "Slots of a frame",
                {
                    "array": name,
                    "class": afferent.name,
                    "within": f"{total_ma:g} mA ± {uneven:.0%}",
                    "frames": kind,
                    "slots": f"{np.mean([len(each) for _, each in plans]):.1f}",
                    "current alone asks": f"{np.mean(begin):.1f}",
                    "points a slot (least)": f"{np.mean(ratio):.1f} ({min(ratio):.1f})",
                    "single points break a bound": sum(not each.kept for each in slots),
                    "other": f"{max(each.figures.off_target for each in slots):.2f}",
                    "spill": f"{max(each.figures.spill for each in slots):.2f}",
                    "ms": f"{1e3 * spent:.0f}",
                    "set up, s": f"{setup:.1f}",
                },
            )


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("afferent", SHOWN)
def test_what_a_spread_leaves(row, quick, profile, afferent):
    operator = FrameOperator(judge_of(profile, afferent))
    frames = {
        "slots of 10 mA": (FrameBounds(), 10.0),
        "slots of 10 mA, bounds of .20": (FrameBounds(0.2, 0.2), 10.0),
        "slots of 50 mA": (FrameBounds(uneven=0.15), FREE_MA),
    }
    judge = operator.judge
    cases = {"nominal": [judge]}
    for part in (0.5,) if quick else (0.25, 0.5, 1.0, 1.5):
        cases[f"depth × {part:g}"] = spread_judges(judge, part, angle=False)
    cases["angle × 1"] = spread_judges(judge, depth=False)
    cases["depth and angle × 1"] = spread_judges(judge)
    for name, (bounds, total_ma) in frames.items():
        slots = [
            (np.where(np.isin(np.arange(64), slot.sites), 1.0, 0.0), slot.current)
            for slot in plan_slots(operator, drawn("T"), bounds, total_ma)
        ]
        table = {
            case: Worst.of([each.judge(w, level) for level, w in slots for each in judges])
            for case, judges in cases.items()
        }
        for gain in (0.05,) if quick else (0.01, 0.02, 0.05):
            table[f"gain error {gain:.0%}"] = Worst.of(
                [
                    judge.judge(drawn_ma, level)
                    for level, w in slots
                    for drawn_ma in with_gain_error(w, gain, 2 if quick else 50, 1)
                ]
            )
        varied = []
        for level, _ in slots:
            for seed in range(1 if quick else 20):
                other = uneven_levels(level, 0.3, seed)
                varied.append(operator.bounded(other, bounds, total_ma)[1])
        table["thresholds ± 30 %, measured"] = Worst.of(varied)
        for case, worst in table.items():
            row(
                "A letter T where the finger is not as designed for",
                {
                    "class": afferent.name,
                    "in": f"{len(slots)} {name}",
                    "finger": case,
                    "other": f"{worst.off_target:.2f}",
                    "spill": f"{worst.spill:.2f}",
                    "targets": f"{worst.weakest:.2f} to {worst.strongest:.2f}",
                },
            )


@pytest.mark.parametrize("afferent", SHOWN)
def test_what_color_classes_cannot_break(row, quick, profile, afferent):
    operator = FrameOperator(judge_of(profile, afferent))
    for step in (4,) if quick else (1, 2, 3, 4):
        classes = color_classes(operator, step)
        row(
            "Points some rows and columns apart",
            {
                "class": afferent.name,
                "every": step,
                "slots": len(classes),
                "other": f"{max(each.off_target for each in classes):.2f}",
                "spill": f"{max(each.spill for each in classes):.2f}",
                "total, mA": f"{max(each.totals_ma.sum() for each in classes):.1f}",
                "electrode, mA": f"{max(each.electrode_ma.max() for each in classes):.2f}",
            },
        )


def test_mixed_frames(row, quick, profile, bank):
    """Points of RA and SAI, at different sites: slots of each class by itself, and of both."""
    both = (Afferent.RA, Afferent.SAI)
    mixed = FrameSlots(profile, bank, both)
    apart = [FrameSlots(profile, bank, (each,)) for each in both]
    count = 2 if quick else 40
    for points in (2,) if quick else (2, 4, 8, 12, 16):
        separate, together, worst, spent = 0, 0, [], []
        for seed in range(count):
            site = np.random.default_rng(seed).choice(64, 2 * points, replace=False)
            rows = np.zeros((2, 64), np.float32)
            rows[0, site[:points]] = rows[1, site[points:]] = 1
            separate += sum(
                len(one.slots(row[None], 1.0).site) for one, row in zip(apart, rows, strict=True)
            )
            start = time.perf_counter()
            found = mixed.slots(rows, 1.0)
            spent.append(time.perf_counter() - start)
            together += len(found.site)
            worst.append((found.proof.off_target.max(), found.proof.spill.max()))
        row(
            "RA and SAI in one frame",
            {
                "points of each": points,
                "slots apart": f"{separate / count:.1f}",
                "slots mixed": f"{together / count:.1f}",
                "other": f"{max(each for each, _ in worst):.2f}",
                "spill": f"{max(each for _, each in worst):.2f}",
                "p50, ms": f"{1e3 * np.median(spent):.0f}",
                "p99, ms": f"{1e3 * np.quantile(spent, 0.99):.0f}",
            },
        )
