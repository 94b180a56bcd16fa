"""Electrode array of a profile as a KiCad board, and as a drawing in true size.

As in profiles, x points right and y downward, and the finger lies on the front side.
"""

from pathlib import Path

import numpy as np

from smarttouch.base.errors import ProfileError
from smarttouch.base.files import write_bytes
from smarttouch.profile.electrodes import Shape
from smarttouch.profile.profile import Profile

CONTACT_PITCH_MM = 0.5  # distance between contacts of a connector for flat flexible cables
CONTACT_MM = (0.3, 3.0)  # width and height of a contact
MOST_CONTACTS = 40  # largest number of contacts of a connector
GAP_MM = 2.0  # gap between connectors
EDGE_MM = 0.5  # distance from copper to the board's edge
TAIL_MM = 10.0  # distance from the electrodes to the contacts
_HEAD = """(kicad_pcb (version 20241229) (generator "smarttouch") (generator_version "9.0")
(layers (0 "F.Cu" signal) (2 "B.Cu" signal) (1 "F.Mask" user) (25 "Edge.Cuts" user)
  (35 "F.Fab" user))
(general (thickness 0.12)) (paper "A4") (setup (pad_to_mask_clearance 0)) (net 0 "")"""
_TEXT = '(at 0 0 0) (layer "F.Fab") (hide yes) (effects (font (size 1 1) (thickness 0.15)))'
# pad number; electrode of the pad's net, or None; x and y, mm; shape; size, mm
_Pad = tuple[int, int | None, float, float, Shape, tuple[float, float]]


def write_kicad(profile: Profile, folder: Path) -> Path:
    """Write a board file of KiCad 9 with electrodes and contacts; return its path.

    Contact ``k + 1`` belongs to output k of the driver board. The contact is on the net of the
    electrode that ``output.wiring`` connects to this output. Nets are named after electrodes.
    Raises ProfileError if the file exists, if it cannot be written, or if an electrode is a point.
    """
    path = folder / f"{profile.name}.kicad_pcb"
    if path.exists():
        raise ProfileError(f"{path} exists and may have tracks: give another folder")
    electrodes, (right, down) = _electrodes(profile)
    wiring = list(profile.output.wiring or range(len(electrodes)))
    output, site_of = np.arange(max(wiring) + 1), {put: site for site, put in enumerate(wiring)}
    block = -(-len(output) // -(-len(output) // MOST_CONTACTS))  # contacts per connector
    x_mm = output * CONTACT_PITCH_MM + output // block * GAP_MM
    right, y_mm = max(right, x_mm[-1] / 2 + 2 * EDGE_MM), down + TAIL_MM
    contacts: list[_Pad] = [
        (number + 1, site_of.get(number), x, y_mm, "rectangle", CONTACT_MM)
        for number, x in enumerate((x_mm - x_mm[-1] / 2).tolist())
    ]
    bottom = y_mm + CONTACT_MM[1] / 2 + EDGE_MM
    corners = f"(start {-right:.6f} {-down:.6f}) (end {right:.6f} {bottom:.6f})"
    lines = [
        f'{_HEAD}\n(title_block (comment 1 "output.wiring = {wiring}"))',
        *(f'(net {site + 1} "{site}")' for site in range(len(electrodes))),
        *_footprint("electrodes", "E1", electrodes), *_footprint("contacts", "J1", contacts),
        f'(gr_rect {corners} (stroke (width 0.05) (type solid)) (layer "Edge.Cuts")))\n',
    ]  # fmt: skip
    folder.mkdir(exist_ok=True)
    write_bytes(path, "\n".join(lines).encode(), ProfileError)
    return path


def drawing(profile: Profile) -> bytes:
    """Return an SVG of the electrodes and their numbers in true size. Raises ProfileError for point
    electrodes."""
    pads, (right, down) = _electrodes(profile)
    size = f'width="{2 * right:.6f}mm" height="{2 * down:.6f}mm" font-size="0.5"'
    view = f'viewBox="{-right:.6f} {-down:.6f} {2 * right:.6f} {2 * down:.6f}" stroke="orange"'
    lines = [f'<svg xmlns="http://www.w3.org/2000/svg" {size} {view} fill="none">']
    for number, _, x, y, shape, (first, second) in pads:
        form, line = f'path d="M{x:.6f} {y - second / 2:.6f}v{second:.6f}"', first
        if shape != "rectangle":  # draw a disc as a ring without a hole
            form, line = f'circle cx="{x:.6f}" cy="{y:.6f}"', (first - second) / 2
            form += f' r="{(first + second) / 4:.6f}"'
        lines.append(f'<{form} stroke-width="{line:.6f}"/>')
        lines.append(f'<text x="{x:.6f}" y="{y:.6f}" stroke="none" fill="black">{number}</text>')
    return "\n".join([*lines, "</svg>\n"]).encode()


def _electrodes(profile: Profile) -> tuple[list[_Pad], tuple[float, float]]:
    """Return the electrodes as pads, and half the width and half the height, mm, of a board that
    has only electrodes."""
    array, places = profile.electrodes, profile.electrodes.position_mm
    if any(shape == "point" for shape, _ in array.kinds):
        raise ProfileError("point electrodes have no copper: set shape and size", key="array.shape")
    kind_of = {site: kind for kind, sites in array.kinds.items() for site in sites.tolist()}
    reach_mm = max(max(size) for _, size in array.kinds) / 2 + EDGE_MM
    right, down = (np.abs(places).max(axis=0) + reach_mm).tolist()
    pads = [(site, site, *place, *kind_of[site]) for site, place in enumerate(places.tolist())]
    return pads, (right, down)


def _footprint(name: str, reference: str, pads: list[_Pad]) -> list[str]:
    lines = [
        f'(footprint "{name}" (layer "F.Cu") (at 0 0) (attr smd)',
        f'  (property "Reference" "{reference}" {_TEXT}) (property "Value" "{name}" {_TEXT})',
    ]
    for number, site, x, y, shape, (width, height) in pads:
        kind, ring = "rect", ""
        if shape == "disc":
            kind, height = "circle", width
        elif shape == "annulus":
            # KiCad adds copper at the anchor of a custom pad, so place the anchor on the ring.
            radius, width = (width + height) / 4, (width - height) / 2
            kind, x, height = "custom", x + radius, width
            ring = f"(gr_circle (center {-radius:.6f} 0) (end 0 0) (width {width:.6f}) (fill no))"
            ring = f"(options (clearance outline) (anchor circle)) (primitives {ring})"
        net = "" if site is None else f'(net {site + 1} "{site}")'
        lines.append(
            f'  (pad "{number}" smd {kind} (at {x:.6f} {y:.6f}) (size {width:.6f} {height:.6f}) '
            f'(layers "F.Cu" "F.Mask") {net} {ring})'
        )
    return [*lines, ")"]
