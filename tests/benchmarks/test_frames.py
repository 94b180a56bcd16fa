"""Frames in one pulse: how near operators come to the optimum, slots per frame, what survives.

All are tables: run with ``--benchmark-only -n0 -s``.
"""

import time

import numpy as np
import pytest

from smarttouch.errors import DesignError
from smarttouch.modes.bank import load_bank
from smarttouch.modes.frames.bound import color_classes
from smarttouch.modes.frames.figures import FrameBounds
from smarttouch.modes.frames.judge import FrameJudge, full_wish
from smarttouch.modes.frames.operator import FrameOperator, Weights, keeps
from smarttouch.modes.frames.programme import joint_programme
from smarttouch.modes.frames.slots import likely_slots, plan_slots
from smarttouch.modes.frames.spread import Worst, spread_judges, uneven_levels, with_gain_error
from smarttouch.primary import Primary
from smarttouch.profile import load_profile
from smarttouch.scan.frames import FrameSlots

LETTERS = {
    "A": "01110 10001 10001 11111 10001 10001 10001",
    "B": "11110 10001 10001 11110 10001 10001 11110",
    "C": "01110 10001 10000 10000 10000 10001 01110",
    "D": "11110 10001 10001 10001 10001 10001 11110",
    "E": "11111 10000 10000 11110 10000 10000 11111",
    "F": "11111 10000 10000 11110 10000 10000 10000",
    "G": "01110 10001 10000 10111 10001 10001 01111",
    "H": "10001 10001 10001 11111 10001 10001 10001",
    "I": "01110 00100 00100 00100 00100 00100 01110",
    "J": "00111 00010 00010 00010 00010 10010 01100",
    "K": "10001 10010 10100 11000 10100 10010 10001",
    "L": "10000 10000 10000 10000 10000 10000 11111",
    "M": "10001 11011 10101 10101 10001 10001 10001",
    "N": "10001 11001 10101 10011 10001 10001 10001",
    "O": "01110 10001 10001 10001 10001 10001 01110",
    "P": "11110 10001 10001 11110 10000 10000 10000",
    "Q": "01110 10001 10001 10001 10101 10010 01101",
    "R": "11110 10001 10001 11110 10100 10010 10001",
    "S": "01111 10000 10000 01110 00001 00001 11110",
    "T": "11111 00100 00100 00100 00100 00100 00100",
    "U": "10001 10001 10001 10001 10001 10001 01110",
    "V": "10001 10001 10001 10001 10001 01010 00100",
    "W": "10001 10001 10001 10101 10101 11011 10001",
    "X": "10001 10001 01010 00100 01010 10001 10001",
    "Y": "10001 10001 01010 00100 00100 00100 00100",
    "Z": "11111 00001 00010 00100 01000 10000 11111",
}
"""Our own drawing, 5 x 7."""
FREE_MA = 50.0
SHOWN = [Primary.RA, Primary.SAI]


def drawn(letter, rows=8, columns=8):
    level = np.zeros((rows, columns))
    picture = np.array([[int(each) for each in row] for row in LETTERS[letter].split()])
    top, left = max((rows - 7) // 2, 0), max((columns - 5) // 2, 0)
    level[top : top + 7, left : left + 5] = picture
    return level.ravel()


def scattered(points, sites, seed):
    level = np.zeros(sites)
    level[np.random.default_rng(seed).choice(sites, points, replace=False)] = 1.0
    return level


def judge_of(profile, primary):
    """Judge by the wishes of the profile's bank, or of the default array's for one without."""
    known = load_profile("electric-mouse") if "x" in profile.name[:3] else profile
    bank = load_bank(known)
    wish = full_wish(known, primary, bank.kernels(primary), bank.receptor[primary])
    if known is not profile:
        wish = np.full(len(profile.electrodes), np.median(wish))
    return FrameJudge(profile, primary, wish)


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("primary", SHOWN)
def test_gap_to_the_optimum(benchmark, capsys, profile, bank, primary):
    judge = judge_of(profile, primary)
    ways = {
        "active only": FrameOperator(judge),
        "against others": FrameOperator(judge, Weights(1.0, 1.0, 0.01)),
        "least current": FrameOperator(judge, Weights(0.0, 0.0, 1.0)),
    }
    kernels = bank.kernels(primary) * profile.full_ma[:, None]
    sets = {"letters": [drawn(each) for each in LETTERS]}
    for points, count in ((2, 25), (4, 75), (8, 50), (16, 50)):
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
            matrix, wish = ways["active only"].matrix, level * judge.wish_af
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
        with capsys.disabled():
            for way, each in found.items():
                other = np.array([figures.worst_other for figures, _, _ in each])
                gap = other / [optimum for _, optimum, _ in each]
                print(
                    f"\n{primary.name} {name}, {way}: other {other.mean():.3f} (worst "
                    f"{other.max():.3f}), of the optimum {np.median(gap):.2f} (95 % "
                    f"{np.quantile(gap, 0.95, method='higher'):.2f}); "
                    f"spill {max(figures.worst_spill for figures, _, _ in each):.2f}; total "
                    f"{np.mean([figures.total_ma for figures, _, _ in each]):.1f} mA; "
                    f"{1e3 * np.median([spent for _, _, spent in each]):.2f} ms",
                    end="",
                )
    benchmark.pedantic(lambda: None, rounds=1)


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("primary", SHOWN)
def test_gap_within_limits(benchmark, capsys, profile, primary):
    """How near the operator comes to the joint optimum if that is what it is asked to keep."""
    judge = judge_of(profile, primary)
    operator, limits = FrameOperator(judge), FrameBounds()
    for points, count in ((2, 25), (4, 75), (8, 50), (16, 50)):
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
        with capsys.disabled():
            print(
                f"\n{primary.name} {points} random ({count}, {none} of them impossible): the "
                f"operator keeps {np.median(gaps):.2f} times the optimum (95 % "
                f"{np.quantile(gaps, 0.95, method='higher'):.2f}, worst {max(gaps):.2f}); "
                f"{1e3 * np.median(slow):.0f} ms to {1e3 * np.median(fast):.1f} ms",
                end="",
            )
    benchmark.pedantic(lambda: None, rounds=1)


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("primary", SHOWN)
@pytest.mark.parametrize("name", ["electric-mouse", "optacon-24x6", "16x16", "32x32"])
def test_slots_per_frame(benchmark, capsys, changed, name, primary):
    if name[0].isdigit():
        rows, columns = map(int, name.split("x"))
        keys = {"array.rows": rows, "array.columns": columns, "name": name}
        profile = changed(load_profile("electric-mouse"), keys)
    else:
        profile = load_profile(name)
        rows, columns = profile.array.rows, profile.array.columns
    judge, sites = judge_of(profile, primary), rows * columns
    start = time.perf_counter()
    operator = FrameOperator(judge)
    setup = time.perf_counter() - start
    few = 4 if sites <= 256 else 1
    sets = {"letters": [drawn(each, rows, columns) for each in LETTERS][: 26 if few > 1 else 4]}
    for density in (0.05, 0.10, 0.25, 0.60):
        points = round(density * sites)
        sets[f"{density:.0%}"] = [scattered(points, sites, seed) for seed in range(few)]
    for total_ma, uneven in ((profile.limits.total_ma, 0.05), (FREE_MA, 0.05), (FREE_MA, 0.15)):
        bounds = FrameBounds(uneven=uneven)
        for kind, levels in sets.items():
            start = time.perf_counter()
            begin = [likely_slots(operator, level, bounds, total_ma) for level in levels]
            plans = [(level, plan_slots(operator, level, bounds, total_ma)) for level in levels]
            spent = (time.perf_counter() - start) / len(levels)
            ratio = [np.count_nonzero(level) / len(slots) for level, slots in plans]
            slots = [slot for _, each in plans for slot in each]
            with capsys.disabled():
                print(
                    f"\n{name} {primary.name} {total_ma:g} mA ± {uneven:.0%} {kind}: "
                    f"{np.mean([len(each) for _, each in plans]):.1f} slots (current alone asks "
                    f"{np.mean(begin):.1f}), "
                    f"of points {np.mean(ratio):.1f} (least {min(ratio):.1f}), "
                    f"{sum(not each.kept for each in slots)} single points break a bound, "
                    f"other {max(each.figures.worst_other for each in slots):.2f}, "
                    f"spill {max(each.figures.worst_spill for each in slots):.2f}, "
                    f"{1e3 * spent:.0f} ms (set up in {setup:.1f} s)",
                    end="",
                )
    benchmark.pedantic(lambda: None, rounds=1)


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("primary", SHOWN)
def test_what_a_spread_leaves(benchmark, capsys, profile, primary):
    operator = FrameOperator(judge_of(profile, primary))
    frames = {
        "slots of 10 mA": (FrameBounds(), 10.0),
        "slots of 10 mA, bounds of .20": (FrameBounds(0.2, 0.2), 10.0),
        "slots of 50 mA": (FrameBounds(uneven=0.15), FREE_MA),
    }
    judge = operator.judge
    cases = {"nominal": [judge]}
    for part in (0.25, 0.5, 1.0, 1.5):
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
        for gain in (0.01, 0.02, 0.05):
            table[f"gain error {gain:.0%}"] = Worst.of(
                [
                    judge.judge(drawn_ma, level)
                    for level, w in slots
                    for drawn_ma in with_gain_error(w, gain, 50, 1)
                ]
            )
        varied = []
        for level, _ in slots:
            for seed in range(20):
                other = uneven_levels(level, 0.3, seed)
                varied.append(operator.bounded(other, bounds, total_ma)[1])
        table["thresholds ± 30 %, measured"] = Worst.of(varied)
        with capsys.disabled():
            for case, worst in table.items():
                print(
                    f"\n{primary.name} letter T in {name} ({len(slots)}), {case}: other "
                    f"{worst.worst_other:.2f}, spill {worst.worst_spill:.2f}, targets "
                    f"{worst.weakest:.2f} to {worst.strongest:.2f}",
                    end="",
                )
    benchmark.pedantic(lambda: None, rounds=1)


@pytest.mark.parametrize("primary", SHOWN)
def test_what_color_classes_cannot_break(benchmark, capsys, profile, primary):
    operator = FrameOperator(judge_of(profile, primary))
    for step in (1, 2, 3, 4):
        classes = color_classes(operator, step)
        with capsys.disabled():
            print(
                f"\n{primary.name}, every {step} rows and columns ({len(classes)} slots): other "
                f"{max(each.worst_other for each in classes):.2f}, spill "
                f"{max(each.worst_spill for each in classes):.2f}, total "
                f"{max(each.total_ma for each in classes):.1f} mA, electrode "
                f"{max(each.electrode_ma.max() for each in classes):.2f} mA",
                end="",
            )
    benchmark.pedantic(lambda: None, rounds=1)


def test_mixed_frames(benchmark, capsys, profile, bank):
    """Points of RA and SAI, at different sites: slots of each class by itself, and of both."""
    both = (Primary.RA, Primary.SAI)
    mixed = FrameSlots(profile, bank, both)
    apart = [FrameSlots(profile, bank, (each,)) for each in both]
    for points in (2, 4, 8, 12, 16):
        separate, together, worst, spent = 0, 0, [], []
        for seed in range(40):
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
            worst.append((found.proof.worst_other.max(), found.proof.worst_spill.max()))
        with capsys.disabled():
            print(
                f"\n{points} RA and {points} SAI points: {separate / 40:.1f} slots apart, "
                f"{together / 40:.1f} mixed; other {max(each for each, _ in worst):.2f}, spill "
                f"{max(each for _, each in worst):.2f}; {1e3 * np.median(spent):.0f} ms, 99 % "
                f"{1e3 * np.quantile(spent, 0.99):.0f}",
                end="",
            )
    benchmark.pedantic(lambda: None, rounds=1)
