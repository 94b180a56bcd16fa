"""Frames on boards with one source: which points share a slot, how many slots, what limits it.

All are tables: run with ``--benchmark-only -n0``. Impedances are equal, spread by ± 30 % and
known to the designer, or spread and unknown: designed for equal ones, judged with the spread.
"""

import itertools
import time
from dataclasses import dataclass

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.boards import reports
from smarttouch.emulator.skin import SkinCircuit
from smarttouch.kernels.bank import load_bank
from smarttouch.kernels.frame_fields import FrameBounds
from smarttouch.kernels.frame_judges import FrameJudge, full_wish
from smarttouch.kernels.frame_operator import FrameOperator, keeps
from smarttouch.kernels.slot_plans import plan_slots
from smarttouch.kernels.switched_design import pole_shares
from smarttouch.profile import load_profile

from ..reference.switched import SwitchedSearch, plan_switched_slots
from .frame_sets import LETTERS, scattered

BOTH = {"output.polarities": ("anodic", "cathodic"), "output.kind": "three-state"}
BOARDS = {
    "electric-mouse three-state": ("electric-mouse", BOTH),
    "kajimoto-61 three-state": ("kajimoto-61", BOTH),
    "kajimoto-61 several against all": ("kajimoto-61", {}),
    "smarttouch-4x4": ("smarttouch-4x4", {}),
}
CASES = [
    (name, afferent)
    for name in BOARDS
    for afferent in (Afferent.RA, Afferent.SAI)
    if "against" not in name or afferent is Afferent.RA
]
FREE_MA = 1e3
PAIRS = 40
SPREADS = 3


@dataclass(frozen=True)
class Case:
    """One board and class: judges of equal and of spread impedances, and what single points do."""

    equal: FrameJudge
    spread: list[FrameJudge]
    points_ma: np.ndarray


@pytest.fixture(params=CASES, ids=lambda each: f"{each[0]} {each[1].name}".replace(" ", "-"))
def case(request, changed, quick):
    name, afferent = request.param
    if quick and (name == "kajimoto-61 three-state" or afferent is Afferent.SAI):
        pytest.skip("the other boards in RA are every path")
    board, keys = BOARDS[name]
    profile = changed(load_profile(board), keys)
    bank = load_bank(profile)
    kernels = np.asarray(bank.kernels(afferent), np.float64)
    wish = full_wish(profile, kernels, bank.receptor[afferent])
    judges = [FrameJudge(profile, afferent, wish)]
    for seed in range(SPREADS):
        kohm = np.random.default_rng(seed).uniform(0.7, 1.3, len(profile.electrodes))
        mine = changed(profile, {"output.impedance_kohm": kohm.tolist()})
        judges.append(FrameJudge(mine, afferent, wish, others=judges[0].others))
    return Case(judges[0], judges[1:], kernels * profile.full_ma[:, None])


def as_it_flows(slot, judge, level, bounds):
    """Return figures, and whether bounds are kept, where impedances are the judge's."""
    states = np.sign(slot.current)[None].astype(np.int8)
    current = slot.figures.total_ma * pole_shares(states, judge.profile.admittance)[0]
    figures = judge.judge(current, only(level, slot.sites))
    return figures, keeps(judge, figures, bounds, current, FREE_MA)


def only(level, sites):
    return np.where(np.isin(np.arange(len(level)), sites), level, 0.0)


def drawn_on(letter, electrodes):
    """Return levels of a letter of 5 x 7, centered, on any array."""
    picture = np.array([[int(each) for each in row] for row in LETTERS[letter].split()])
    place = electrodes.position_mm - electrodes.position_mm.mean(axis=0)
    steps = [np.diff(np.unique(each.round(6))).max() for each in place.T]
    column, row = (np.rint(place / steps + [2, 3] - 1e-3)).astype(int).T
    inside = (column >= 0) & (column < 5) & (row >= 0) & (row < 7)
    return np.where(inside, picture[np.clip(row, 0, 6), np.clip(column, 0, 4)], 0).astype(float)


def worst(figures):
    return (
        f"other {max(each.off_target for each in figures):.2f}, "
        f"spill {max(each.spill for each in figures):.2f}, targets "
        f"{min(each.weakest for each in figures):.2f} to "
        f"{max(each.strongest for each in figures):.2f}, source "
        f"{np.mean([each.total_ma for each in figures]):.1f} (most "
        f"{max(each.total_ma for each in figures):.1f}) mA"
    )


@pytest.mark.timeout(900)
def test_pairs(row, quick, request, case):
    electrodes, bounds = case.equal.profile.electrodes, FrameBounds()
    pitches = electrodes.distance_mm / electrodes.pitch_mm
    for apart in (1, 3) if quick else (1, 2, 3, 4, 5, 6):
        pairs = [
            pair
            for pair in itertools.combinations(range(len(electrodes)), 2)
            if abs(pitches[pair] - apart) < 0.25
        ]
        if not pairs:
            continue
        chosen = np.random.default_rng(0).permutation(len(pairs))[: 1 if quick else PAIRS]
        table = {"equal": [], "known": [], "unknown": []}
        for index in chosen:
            level = only(np.ones(len(electrodes)), pairs[index])
            slot = SwitchedSearch(case.equal, level, bounds, FREE_MA).best()
            table["equal"].append((slot.figures, slot.kept))
            for judge in case.spread:
                known = SwitchedSearch(judge, level, bounds, FREE_MA).best()
                table["known"].append((known.figures, known.kept))
                table["unknown"].append(as_it_flows(slot, judge, level, bounds))
        for way, found in table.items():
            kept = np.mean([each for _, each in found])
            shown = [figures for figures, each in found if each or way == "unknown"]
            row(
                "Pairs that share one source",
                {
                    "board": request.node.callspec.id,
                    "pitches apart": apart,
                    "impedances": way,
                    "share": f"{kept:.0%}",
                    "figures": worst(shown) if shown else "",
                },
            )


@pytest.mark.timeout(900)
def test_how_many_at_once(row, quick, request, case):
    """Random points in one slot, current free: where selectivity and evenness end it."""
    count = len(case.equal.profile.electrodes)
    asked = {
        "all bounds": FrameBounds(),
        "± 15 %": FrameBounds(uneven=0.15),
        "selectivity alone": FrameBounds(uneven=0.9),
        "evenness alone": FrameBounds(other=100, spill=100),
    }
    for points in (2,) if quick else (2, 3, 4, 6, 8, 12, 16):
        if points > count * 0.5:
            break
        levels = [scattered(points, count, seed) for seed in range(1 if quick else 20)]
        for way, judges in (("equal", [case.equal]), ("known", case.spread)):
            share = {}
            for name, bounds in asked.items():
                slots = [
                    SwitchedSearch(judge, level, bounds, FREE_MA).best()
                    for level in levels
                    for judge in judges
                ]
                share[name] = f"{np.mean([each.kept for each in slots]):.0%}"
            known = {"board": request.node.callspec.id, "random points": points}
            row("Points that share one slot", known | {"impedances": way} | share)


@pytest.mark.timeout(1800)
def test_slots_per_frame(row, quick, request, changed, case):
    profile = case.equal.profile
    count = len(profile.electrodes)
    sets = {
        "letters": [drawn_on(each, profile.electrodes) for each in ("T" if quick else "AEHLSX")]
    }
    if count < 35:
        sets = {}
    for density in (0.10,) if quick else (0.10, 0.25, 0.60):
        points = round(density * count)
        sets[f"{density:.0%}"] = [
            scattered(points, count, seed) for seed in range(1 if quick else 3)
        ]
    free = changed(profile, {"output.kind": "weighted"})
    weighted = FrameOperator(FrameJudge(free, case.equal.afferent, case.equal.wish_af))
    for (total_ma, uneven), (kind, levels) in itertools.product(
        ((10.0, 0.05), (50.0, 0.05), (50.0, 0.15))[: 1 if quick else 3], sets.items()
    ):
        bounds = FrameBounds(uneven=uneven)
        points = np.mean([np.count_nonzero(level) for level in levels])
        most = [len(plan_slots(weighted, level, bounds, total_ma)) for level in levels]
        says = {"points": f"{points:.0f}", "slots if weighted": f"{np.mean(most):.1f}"}
        for way, judge, steps in (
            ("equal", case.equal, 40),
            ("equal, no search", case.equal, 0),
            ("known", case.spread[0], 40),
        ):
            start = time.perf_counter()
            # The bank's kernels are for equal impedances.
            alone = None if way == "known" else case.points_ma
            plans = [
                plan_switched_slots(judge, level, bounds, total_ma, alone, steps)
                for level in levels
            ]
            spent = (time.perf_counter() - start) / len(levels)
            slots = [slot for plan in plans for slot in plan]
            says[way] = (
                f"{np.mean([len(plan) for plan in plans]):.1f} slots, most "
                f"{max(len(each.sites) for each in slots)} points in one, "
                f"{sum(not each.kept for each in slots)} break a bound, {1e3 * spent:.0f} ms; "
                + worst([each.figures for each in slots])
            )
            if way == "equal":
                real = [
                    as_it_flows(slot, spread, level, bounds)
                    for level, plan in zip(levels, plans, strict=True)
                    for slot in plan
                    for spread in case.spread
                ]
                says["unknown"] = (
                    f"{np.mean([kept for _, kept in real]):.0%} of those slots hold; "
                    + worst([figures for figures, _ in real])
                )
        known = {"board": request.node.callspec.id, "frames": kind}
        row("Slots with one source", known | {"within": f"{total_ma:g} mA ± {uneven:.0%}"} | says)


@pytest.mark.parametrize("spread", [0.15, 0.3])
def test_split_by_measured_impedances(row, quick, spread):
    """By how much cathodes of one source get more than impedances, measured at 100 µs, say.

    On the emulator's skin; one of them that comes off leaves its part to the others.
    """
    electrodes, rng = 64, np.random.default_rng(1)
    skin, volts = SkinCircuit(electrodes, spread=spread, seed=3), []
    for cathode in range(electrodes):
        state = np.where(np.arange(electrodes) == cathode, 1, -1).astype(np.int8)
        volts.append(skin.switched_pulse(state, 200.0, 100.0).source_v)
        skin.short(5000)
    kohm = reports.judge(np.array(volts), 0.2, skin.compliance_v).kohm
    for width_us in (20.0, 50.0, 100.0, 200.0):
        told, equal, off = [], [], []
        for _ in range(20 if quick else 300):
            cathodes = rng.permutation(electrodes)[: rng.integers(2, 5)]
            state = np.full(electrodes, -1, np.int8)
            state[cathodes] = 1
            source_ua = 1000.0 * len(cathodes)
            own_ua = skin.switched_pulse(state, source_ua, width_us).current_ua[cathodes]
            skin.short(50)
            share_ua = source_ua / kohm[cathodes] / (1 / kohm[cathodes]).sum()
            told.append((own_ua / share_ua).max() - 1)
            equal.append(own_ua.max() / 1000 - 1)
            off.append(len(cathodes) / (len(cathodes) - 1) - 1)
        cells = {"spread": f"± {spread:.0%}", "width, µs": f"{width_us:g}"}
        cells |= {"above the measured share": f"{max(told):.0%}", "above the equal one":
                  f"{max(equal):.0%}", "if one comes off": f"{max(off):.0%}"}  # fmt: skip
        row("What a cathode gets at most of one source that several share", cells)
        assert width_us < 100 or max(told) < max(equal)
