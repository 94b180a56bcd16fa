"""Figures of shared slots: the currents of each slot, and the fields of each class."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import KernelBank
from smarttouch.kernels.frame_fields import FieldMap, FrameBounds
from smarttouch.kernels.frame_judges import FrameJudge, SlotJudge, full_wish
from smarttouch.kernels.frame_operator import FrameOperator
from smarttouch.kernels.slot_plans import FrameSlot, plan_slots
from smarttouch.physiology.activating_function import depth_mm, everywhere
from smarttouch.profile import Profile
from smarttouch.stimulation.scan_sequence import unsupported_reason
from smarttouch.views.figure_style import SIGNED_MAP, new_figure, plain
from smarttouch.views.kernel_figures import draw_electrodes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

LETTER = (
    "........",
    ".######.",
    "...#....",
    "...#....",
    "...#....",
    "...#....",
    "...#....",
    "...#....",
)
"""Our own drawing of a T, # where RA is to fire."""
MIXED = (
    "........",
    "R.S..R.S",
    "........",
    "........",
    "........",
    "........",
    "S.R..S.R",
    "........",
)
"""R where RA is to fire, S where SAI is."""

_CLASSES = (Afferent.RA, Afferent.SAI)
_STEP_MM = 0.25
_MOST_SHOWN = 3
_DARK = "#303030"


@dataclass(frozen=True, eq=False)
class SlotPlan:
    """Plan of a drawing: a judge for each class that is to fire, and slots at full intensity."""

    judges: tuple[FrameJudge, ...]
    slots: list[FrameSlot]

    def sites(self, slot: FrameSlot, afferent: Afferent) -> NDArray[np.intp]:
        """Return the electrodes under which a slot is to fire a class."""
        index = [judge.afferent for judge in self.judges].index(afferent)
        owner, site = divmod(slot.sites, len(slot.current))
        return np.asarray(site[owner == index])

    def weakest(self, slot: FrameSlot, afferent: Afferent) -> float:
        """Return the activation of a slot's weakest target of a class, V/mm².

        Of any class where the slot has none of that one.
        """
        reached = {
            judge.afferent: judge.target[self.sites(slot, judge.afferent)] @ slot.current
            for judge in self.judges
        }
        own = reached[afferent]
        return float((own if len(own) else np.concatenate(list(reached.values()))).min())


def drawable(profile: Profile) -> bool:
    """Return whether a profile has 8 x 8 electrodes, each with its own current, for both drawings.

    None of the points drawn may be masked.
    """
    array = profile.array
    if array.layout != "grid" or unsupported_reason(profile) is not None:
        return False
    used = ~(_marked(LETTER, ".") & _marked(MIXED, "."))
    return (array.rows, array.columns) == (len(LETTER), len(LETTER[0])) and bool(
        np.isin(np.flatnonzero(used), profile.driven).all()
    )


def plan_letter(profile: Profile, bank: KernelBank) -> SlotPlan:
    """Return the slots of `LETTER` in RA, at full intensity."""
    return _share(profile, bank, {Afferent.RA: _marked(LETTER, "#")})


def plan_mixed(profile: Profile, bank: KernelBank) -> SlotPlan:
    """Return the slots of `MIXED` in RA and SAI, at full intensity."""
    return _share(profile, bank, {each: _marked(MIXED, each.name[0]) for each in _CLASSES})


def frame_figure(profile: Profile, bank: KernelBank) -> "Figure":
    """Draw a letter in shared slots, and a slot with points of two classes.

    The profile must be `drawable`; shared slots are to reach what the kernels would.
    """
    letter, mixed = plan_letter(profile, bank), plan_mixed(profile, bank)
    both = max(mixed.slots, key=lambda slot: len(slot.sites))
    alone_ma = {}
    for each in _CLASSES:
        own = np.isin(np.arange(len(profile.electrodes)), mixed.sites(both, each))
        slots = _share(profile, bank, {each: own}).slots
        alone_ma[each] = sum(slot.figures.total_ma for slot in slots)
    lattices = {each: _Lattice(profile, each) for each in _CLASSES}
    drawn_ma = [slot.current for slot in (*letter.slots[:_MOST_SHOWN], both)]
    figure = new_figure(8.6, 7.9)
    panels = figure.subplots(3, _MOST_SHOWN + 1, sharex=True, sharey=True)
    panels[0, 0].locator_params(nbins=4)
    pen = _Pen(profile, lattices, float(np.abs(drawn_ma).max()))
    _draw_letter(panels[:2], pen, letter)
    currents, field = _draw_mixed(panels[2], pen, mixed, both, alone_ma)
    ends = (
        (currents, "current (mA), cathodic > 0"),
        (field, "activating function, of the weakest target's"),
    )
    for (drawn, label), beside in zip(ends, (panels[:, :2], panels[:, 2:]), strict=True):
        bar = figure.colorbar(
            drawn, ax=beside, orientation="horizontal", aspect=22, shrink=0.9,
            extend="both" if drawn is field else "neither",
        )  # fmt: skip
        bar.set_label(label, fontsize=8)
        bar.ax.tick_params(labelsize=7)
    return figure


class _Lattice:
    """Fields of currents for one class, on nodes dense enough to be drawn."""

    def __init__(self, profile: Profile, afferent: Afferent) -> None:
        skin = profile.skin.model_copy(update={"node_spacing_mm": _STEP_MM})
        close = profile.model_copy(update={"skin": skin})
        nodes = everywhere(close, afferent)
        self._field, self.grid = FieldMap(close, nodes), nodes.grid
        place = nodes.position_mm.reshape(*nodes.grid, 2)
        self.x_mm, self.y_mm = place[0, :, 0], place[:, 0, 1]

    def af(self, plan: SlotPlan, slot: FrameSlot, afferent: Afferent) -> Array:
        """Return the AF in the strongest direction, relative to the weakest target, (Y, X)."""
        reached = self._field(slot.current[None]).reshape(-1, *self.grid).max(axis=0)
        return np.asarray(reached / plan.weakest(slot, afferent), np.float64)


def _marked(picture: Sequence[str], mark: str) -> NDArray[np.bool_]:
    return np.array([each == mark for row in picture for each in row])


def _share(
    profile: Profile, bank: KernelBank, points: dict[Afferent, NDArray[np.bool_]]
) -> SlotPlan:
    kernels = {each: np.asarray(bank.kernels(each), np.float64) for each in points}
    judges = tuple(
        FrameJudge(profile, each, full_wish(profile, own, bank.receptor[each]))
        for each, own in kernels.items()
    )
    level = np.concatenate(list(points.values())).astype(np.float64)
    alone = np.concatenate([own * profile.full_ma[:, None] for own in kernels.values()])
    frames = profile.frames
    bounds = FrameBounds(frames.other, frames.spill, frames.uneven)
    slots = plan_slots(FrameOperator(SlotJudge(judges)), level, bounds, points_ma=alone)
    return SlotPlan(judges, slots)


@dataclass(frozen=True, eq=False)
class _Pen:
    """Draws the electrodes of a profile, and points and fields on them."""

    profile: Profile
    lattices: dict[Afferent, _Lattice]
    scale_ma: float

    def points(self, axes: Any, names: dict[int, str]) -> None:
        """Draw a name at each of some electrodes."""
        draw_electrodes(axes, self.profile, facecolor="none")
        box = {"boxstyle": "round,pad=0.25", "facecolor": _DARK, "edgecolor": "none"}
        for site, name in names.items():
            place = self.profile.electrodes.position_mm[site]
            axes.text(*place, name, ha="center", va="center", fontsize=7, color="white", bbox=box)

    def currents(self, axes: Any, current_ma: Array) -> Any:
        scale = (-self.scale_ma, self.scale_ma)
        discs = draw_electrodes(axes, self.profile, cmap=SIGNED_MAP, clim=scale)
        discs.set_array(current_ma)
        return discs

    def field(self, axes: Any, afferent: Afferent, af: Array, sites: NDArray[np.intp]) -> Any:
        """Draw the field of a class, and the targets."""
        x_mm, y_mm = self.lattices[afferent].x_mm, self.lattices[afferent].y_mm
        drawn = axes.pcolormesh(
            x_mm, y_mm, af, cmap=SIGNED_MAP, vmin=-1, vmax=1, rasterized=True, shading="gouraud"
        )
        draw_electrodes(axes, self.profile, facecolor="none")
        axes.plot(*self.profile.electrodes.position_mm[sites].T, "+", color="black", ms=6)
        return drawn

    def where(self, afferent: Afferent) -> str:
        return f"at {afferent.name}, {depth_mm(self.profile.skin, afferent):g} mm deep"


def _draw_letter(panels: Any, pen: _Pen, letter: SlotPlan) -> None:
    """Draw the whole letter in the first column, and a slot in each of the others."""
    afferent, slots = Afferent.RA, letter.slots
    sites = [letter.sites(slot, afferent) for slot in slots]
    af = [pen.lattices[afferent].af(letter, slot, afferent) for slot in slots]
    all_sites = np.concatenate(sites)
    top, below = panels[:, 0]
    pen.points(top, {int(each): str(number) for number, own in enumerate(sites, 1) for each in own})
    many = len(slots)
    title = f"A letter, {afferent.name}: {len(all_sites)} slots point\nby point, {many} shared"
    plain(top, title, "", "y (mm)")
    pen.field(below, afferent, np.max(af, axis=0), all_sites)
    plain(below, f"all slots together\n{pen.where(afferent)}", "", "y (mm)")
    for index, (top, below) in enumerate(panels[:, 1:].T):
        if index >= many:
            top.set_axis_off()
            below.set_axis_off()
            continue
        name = f"slot {index + 1} of {many}"
        pen.currents(top, slots[index].current)
        plain(top, f"{name}\ncurrents")
        pen.field(below, afferent, af[index], sites[index])
        plain(below, f"{name}\n{pen.where(afferent)}", _figures(slots[index]))


def _draw_mixed(
    panels: Any,
    pen: _Pen,
    mixed: SlotPlan,
    slot: FrameSlot,
    alone_ma: dict[Afferent, float],
) -> tuple[Any, Any]:
    """Draw a slot of two classes; return the artists with the scales of currents and fields."""
    sites = {each: mixed.sites(slot, each) for each in _CLASSES}
    pen.points(panels[0], {int(site): each.name for each in _CLASSES for site in sites[each]})
    count = " and ".join(f"{len(own)} {each.name}" for each, own in sites.items())
    plain(panels[0], f"One slot, two classes:\n{count} points", _figures(slot), "y (mm)")
    currents = pen.currents(panels[1], slot.current)
    needed = ", ".join(f"{each.name} {total:.1f} mA" for each, total in alone_ma.items())
    plain(panels[1], "mixed slot\ncurrents", f"alone: {needed}")
    for axes, each in zip(panels[2:], _CLASSES, strict=True):
        field = pen.field(axes, each, pen.lattices[each].af(mixed, slot, each), sites[each])
        plain(axes, f"mixed slot\n{pen.where(each)}", "x (mm)")
    return currents, field


def _figures(slot: FrameSlot) -> str:
    found, count = slot.figures, len(slot.sites)
    return (
        f"{count} point{'' if count == 1 else 's'}, {found.total_ma:.1f} mA\n"
        f"worst other {found.off_target:.2f}, spill {found.spill:.2f}"
    )
