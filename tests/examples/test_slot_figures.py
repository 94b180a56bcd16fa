"""The picture of shared slots shows what the plan says, on the very electrodes that it drives."""

import numpy as np
import pytest
from matplotlib.text import Text
from studies.slot_figures import LETTER, MIXED, drawable, frame_figure, plan_letter, plan_mixed

from smarttouch.base.afferent import Afferent
from smarttouch.physiology.activating_function import af_matrix, everywhere
from smarttouch.profile import load_profile
from smarttouch.stimulation.frame_slots import FrameSlots
from smarttouch.views.figure_style import save

from ..said import numbers_in
from ..whole import sample

RA, SAI = Afferent.RA, Afferent.SAI


def marked(picture, mark):
    return np.array([each == mark for row in picture for each in row])


@pytest.fixture(scope="module")
def plans(profile, bank):
    return plan_letter(profile, bank), plan_mixed(profile, bank)


@pytest.fixture(scope="module")
def figure(profile, bank):
    return frame_figure(profile, bank)


@pytest.fixture(scope="module")
def panels(figure):
    return np.array(figure.axes[:12]).reshape(3, 4)


@pytest.fixture(scope="module")
def rows(profile):
    """AF rows, (D, Y, X, E), every .5 mm, where drawn and judged fields meet; their places."""
    made = {}
    for afferent in (RA, SAI):
        nodes = everywhere(profile, afferent)
        af = af_matrix(profile, nodes).reshape(-1, *nodes.grid, 64)
        made[afferent] = af[:, ::5, ::5], nodes.position_mm.reshape(*nodes.grid, 2)[::5, ::5]
    return made


def current_drawn(axes):
    """Return currents at the electrodes' places as drawn, (E,) mA, and the places."""
    (discs,) = axes.collections
    extents = [each.get_extents() for each in discs.get_paths()]
    place = np.array([(each.min + each.max) / 2 for each in extents])
    return np.asarray(discs.get_array()), place.round(9)


def field_drawn(axes, where_mm):
    """Return the field drawn at some of the places of its mesh."""
    mesh = axes.collections[0]
    mesh_mm = np.asarray(mesh.get_coordinates())
    x, y = mesh_mm[0, :, 0], mesh_mm[:, 0, 1]
    column = np.abs(x[:, None] - where_mm[0, :, 0]).argmin(axis=0)
    line = np.abs(y[:, None] - where_mm[:, 0, 1]).argmin(axis=0)
    assert x[column] == pytest.approx(where_mm[0, :, 0])
    assert y[line] == pytest.approx(where_mm[:, 0, 1])
    return np.asarray(mesh.get_array()).reshape(len(y), len(x))[np.ix_(line, column)]


def sites_marked(axes, profile):
    """Return the electrodes that have a +."""
    (marks,) = [line for line in axes.lines if line.get_marker() == "+"]
    away = np.linalg.norm(profile.electrodes.position_mm[:, None] - marks.get_xydata(), axis=2)
    assert away.min(axis=0) == pytest.approx(0)
    return sorted(away.argmin(axis=0).tolist())


def names_drawn(axes, profile):
    """Return what is written at which electrode."""
    return {
        int(np.hypot(*(profile.electrodes.position_mm - each.get_position()).T).argmin()): (
            each.get_text()
        )
        for each in axes.texts
    }


def figures_of(slot):
    found = slot.figures
    return (
        f"{len(slot.sites)} points, {found.total_ma:.1f} mA\n"
        f"worst other {found.off_target:.2f}, spill {found.spill:.2f}"
    )


def test_a_letter_takes_a_quarter_of_the_slots(plans, panels, profile):
    letter, _ = plans
    sites = np.concatenate([slot.sites for slot in letter.slots])
    assert sorted(sites) == np.flatnonzero(marked(LETTER, "#")).tolist()
    assert len(letter.slots) <= len(sites) / 4
    assert all(slot.kept for slot in letter.slots)
    title = panels[0, 0].get_title(loc="left").replace("\n", " ")
    assert "RA" in title
    assert numbers_in(title) == [len(sites), len(letter.slots)]
    assert names_drawn(panels[0, 0], profile) == {
        site: str(number) for number, slot in enumerate(letter.slots, 1) for site in slot.sites
    }
    assert sites_marked(panels[1, 0], profile) == sorted(sites)


def test_each_slot_is_drawn_as_planned(plans, panels, profile, rows):
    letter, _ = plans
    assert len(letter.slots) == 3
    af, where_mm = rows[RA]
    all_slots = field_drawn(panels[1, 0], where_mm)
    strongest = np.full(all_slots.shape, -np.inf)
    for slot, (above, below) in zip(letter.slots, panels[:2, 1:].T, strict=True):
        current, place = current_drawn(above)
        assert np.array_equal(current, slot.current)
        assert np.array_equal(place, profile.electrodes.position_mm)
        weakest = (letter.judges[0].target[slot.sites] @ slot.current).min()
        expected = (af @ slot.current).max(axis=0) / weakest
        drawn = field_drawn(below, where_mm)
        assert drawn == pytest.approx(expected, abs=2e-3)
        # Far from targets the class gets what is written beneath.
        away = np.linalg.norm(where_mm[:, :, None] - place[slot.sites], axis=3).min(axis=2)
        assert drawn[away > 2 + 1e-6].max() == pytest.approx(slot.figures.spill, abs=2e-3)
        assert sites_marked(below, profile) == slot.sites.tolist()
        assert below.get_xlabel() == figures_of(slot)
        strongest = np.maximum(strongest, expected)
    assert all_slots == pytest.approx(strongest, abs=2e-3)


def test_two_classes_in_one_slot(plans, panels, profile, rows, bank):
    _, mixed = plans
    (slot,) = mixed.slots
    wanted = {each: np.flatnonzero(marked(MIXED, each.name[0])) for each in (RA, SAI)}
    current, _ = current_drawn(panels[2, 1])
    assert np.array_equal(current, slot.current)
    # Each the other's return: RA's are the anodes, SAI's the cathodes.
    assert (current[wanted[RA]] < -1).all()
    assert (current[wanted[SAI]] > 1).all()
    assert panels[2, 0].get_xlabel() == figures_of(slot)
    assert names_drawn(panels[2, 0], profile) == {
        site: each.name for each in (RA, SAI) for site in wanted[each]
    }
    for axes, judge in zip(panels[2, 2:], mixed.judges, strict=True):
        each = judge.afferent
        assert sites_marked(axes, profile) == wanted[each].tolist()
        af, where_mm = rows[each]
        weakest = (judge.target[wanted[each]] @ current).min()
        expected = (af @ current).max(axis=0) / weakest
        assert field_drawn(axes, where_mm) == pytest.approx(expected, abs=2e-3)
    alone = []
    for each in (RA, SAI):
        image = marked(MIXED, each.name[0])[None].astype(np.float32)
        sent = FrameSlots(profile, bank, (each,)).slots(image, 1.0)
        alone.append(np.abs(sent.current_ua).sum() / 2000)
    # Scans plan within .99 of the bounds.
    assert numbers_in(panels[2, 1].get_xlabel()) == pytest.approx(alone, rel=0.02)
    assert slot.figures.total_ma < 0.6 * sum(alone)


def test_it_is_what_a_scan_sends(plans, profile, bank):
    """Scans plan within .99 of the bounds, and round to whole µA."""
    letter, mixed = plans
    image = marked(LETTER, "#")[None].astype(np.float32)
    sent = FrameSlots(profile, bank, (RA,)).slots(image, 1.0)
    assert sent.current_ua == pytest.approx(
        1000 * np.array([slot.current for slot in letter.slots]), abs=1, rel=0.02
    )
    image = np.array([marked(MIXED, "R"), marked(MIXED, "S")], np.float32)
    sent = FrameSlots(profile, bank, (RA, SAI)).slots(image, 1.0)
    assert sent.proof.points.tolist() == [len(slot.sites) for slot in mixed.slots]


def test_scales_are_those_of_all_panels(figure, panels):
    currents = [panels[0, 1], panels[0, 2], panels[0, 3], panels[2, 1]]
    most = max(np.abs(current_drawn(axes)[0]).max() for axes in currents)
    assert {axes.collections[0].get_clim() for axes in currents} == {(-most, most)}
    fields = [*panels[1], *panels[2, 2:]]
    assert {axes.collections[0].get_clim() for axes in fields} == {(-1, 1)}
    current, field = (axes.get_xlabel() for axes in figure.axes[12:])
    assert "(mA)" in current
    assert "cathodic > 0" in current
    assert "mA" not in field


def test_text_does_not_overlap_and_the_file_is_written(figure, tmp_path):
    save(figure, tmp_path / "frames.png")
    assert (tmp_path / "frames.png").stat().st_size > 50_000
    figure.set_layout_engine("none")  # it stays as it was laid out for the file
    figure.draw_without_rendering()
    # Titles and labels; smaller are numbers at ticks, and names at electrodes.
    texts = [each for each in figure.findobj(Text) if each.get_text() and each.get_fontsize() >= 8]
    assert len(texts) == 12 + 3 + 3 + 4 + 2
    boxes = [each.get_window_extent() for each in texts]
    for index, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:index])
        assert 0 <= box.x0 < box.x1 <= figure.bbox.x1


@pytest.mark.parametrize(
    ("key", "value", "slots"),
    sample([("limits.total_ma", 5.0, 7), ("perception.threshold_ma", 0.2, 1)]),
)
def test_as_many_slots_as_total_current_requires(profile, bank, changed, key, value, slots):
    other = changed(profile, {key: value})
    panels = np.array(frame_figure(other, bank).axes[:12]).reshape(3, 4)
    many = len(plan_letter(other, bank).slots)
    assert many == pytest.approx(slots, abs=1)
    shown = [axes.get_title(loc="left") for axes in panels[0, 1:] if axes.axison]
    assert shown == [f"slot {number} of {many}\ncurrents" for number in range(1, min(many, 3) + 1)]


def test_only_where_all_points_can_be_driven(profile, changed):
    assert drawable(profile)
    corner, used = 0, int(np.flatnonzero(marked(LETTER, "#"))[0])
    assert drawable(changed(profile, {"output.masked": [corner]}))
    assert not drawable(changed(profile, {"output.masked": [used]}))
    assert not drawable(changed(profile, {"array.rows": 9}))
    for name in ("kajimoto-61", "line-8", "etactilekit-32", "optacon-24x6", "smarttouch-4x4"):
        assert not drawable(load_profile(name))
