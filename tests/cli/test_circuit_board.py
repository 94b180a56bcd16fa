"""Tests of exported KiCad boards and SVG drawings, read by the parsers of this module."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

import smarttouch as st
from smarttouch.boards.kits.etactilekit import ETactileKitDriver
from smarttouch.profile.toml_files import as_toml
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..support.scans import sequence


def parsed(text):
    """Parse an S-expression; return nested lists of strings."""
    stack = [[]]
    for opens, closes, quoted, word in re.findall(
        r'(\()|(\))|"((?:[^"\\]|\\.)*)"|([^\s()"]+)', text
    ):
        if opens:
            stack.append([])
        elif closes:
            stack[-2].append(stack.pop())
        else:
            stack[-1].append(quoted or word)
    ((root,),) = stack
    return root


def parts(expression, name):
    return [part for part in expression if isinstance(part, list) and part[:1] == [name]]


def numbers(expression, name):
    (part,) = parts(expression, name)
    return np.array(part[1:], float)


def copper(pad):
    """Return the center of a pad, mm, and its shape and size as a profile states them."""
    place, (width, height) = numbers(pad, "at"), numbers(pad, "size")
    if pad[3] == "circle":
        assert width == height
        return (*place, "disc", width, 0)
    if pad[3] == "rect":
        return (*place, "rectangle", width, height)
    (ring,) = parts(parts(pad, "primitives")[0], "gr_circle")
    radius, line = np.hypot(*numbers(ring, "center")), numbers(ring, "width")[0]
    # Only the ring is copper. Its inside is not filled, and the pad's anchor lies on the ring.
    assert parts(ring, "fill") == [["fill", "no"]]
    assert (width, height) == (line, line)
    return (*(place + numbers(ring, "center")), "annulus", 2 * radius + line, 2 * radius - line)


def drawn(shape):
    """Return center, shape and size of an SVG element of a drawing, mm."""
    line = float(shape.get("stroke-width"))
    if shape.tag.endswith("path"):
        x, y, length = map(float, re.fullmatch(r"M(\S+) (\S+)v(\S+)", shape.get("d")).groups())
        return x, y + length / 2, "rectangle", line, length
    x, y, radius = (float(shape.get(name)) for name in ("cx", "cy", "r"))
    inner = 2 * radius - line
    return x, y, "annulus" if inner > 1e-9 else "disc", 2 * radius + line, inner


def wanted(profile):
    array = profile.electrodes
    kind_of = {site: kind for kind, sites in array.kinds.items() for site in sites.tolist()}
    return [
        (*array.position_mm[site], kind_of[site][0], *kind_of[site][1])
        for site in range(len(array))
    ]


def assert_same(found, expected):
    assert [each[2] for each in found] == [each[2] for each in expected]
    for each in (0, 1, 3, 4):
        there, there_too = ([row[each] for row in rows] for rows in (found, expected))
        np.testing.assert_allclose(there, there_too, rtol=0, atol=0.001)


@pytest.fixture
def export(program_here, tmp_path):
    """Return a function that exports a profile and returns profile, board and drawing."""

    def run(name, *options):
        done = program_here(f"profiles show {name} --kicad=made --svg=made.svg", *options).fine()
        (tmp_path / "made.toml").write_text(done.stdout, encoding="utf-8")
        (board,) = (tmp_path / "made").glob("*.kicad_pcb")
        drawing = ET.parse(tmp_path / "made.svg").getroot()
        profile = st.load_profile(tmp_path / "made.toml")
        return profile, parsed(board.read_text(encoding="utf-8")), drawing

    return run


@pytest.mark.parametrize("name", st.list_profiles())
def test_copper_is_that_of_the_profile_to_a_micrometer(export, name):
    profile, board, drawing = export(name)
    electrodes, _ = parts(board, "footprint")
    pads = parts(electrodes, "pad")
    sites = [str(site) for site in range(len(profile.electrodes))]
    assert [pad[1] for pad in pads] == [parts(pad, "net")[0][2] for pad in pads] == sites
    assert numbers(electrodes, "at").tolist() == [0, 0]
    assert_same([*map(copper, pads)], wanted(profile))
    # A unit of the drawing is a millimeter.
    *_, width, height = map(float, drawing.get("viewBox").split())
    size = [float(drawing.get(side).removesuffix("mm")) for side in ("width", "height")]
    assert size == [width, height]
    shapes = [shape for shape in drawing if shape.get("stroke-width")]
    assert_same([*map(drawn, shapes)], wanted(profile))
    assert [shape.text for shape in drawing if shape.text and shape.text.strip()] == sites


def test_a_driver_reaches_each_electrode_through_the_board(export):
    """The contact and the net of each driver output lead to the pad of the right electrode."""
    profile, board, _ = export("etactilekit-32")
    electrodes, connector = parts(board, "footprint")
    nets = {code: name for _, code, name in parts(board, "net")}
    place_of = {parts(pad, "net")[0][1]: numbers(pad, "at") for pad in parts(electrodes, "pad")}
    net_of = {int(pad[1]): parts(pad, "net")[0][1] for pad in parts(connector, "pad")}
    driver = ETactileKitDriver("nowhere", SafetyLimits.of(profile), profile.output)
    for site, position in enumerate(profile.electrodes.position_mm):
        current = np.where(np.arange(32) == site, 310, -10)
        alone = replace(sequence([current], 100, electrodes=32), site=np.array([site], np.uint16))
        _, heights = driver.encode(alone)
        (output,) = np.flatnonzero(np.frombuffer(heights, "<u2"))
        net = net_of[output + 1]
        assert nets[net] == str(site)
        np.testing.assert_allclose(place_of[net], position, rtol=0, atol=0.001)


def test_wiring_of_the_profile_is_followed_and_free_outputs_stay_bare(export, tmp_path):
    profile = st.load_profile("smarttouch-4x4")
    wiring = (*range(50, 58), *range(8, 16))
    output = profile.output.model_dump() | {"wiring": wiring}
    text = as_toml(profile.model_copy(update={"output": output}))
    (tmp_path / "wired.toml").write_text(text, encoding="utf-8")
    _, board, _ = export("wired.toml")
    _, connector = parts(board, "footprint")
    pads = parts(connector, "pad")
    nets = {int(pad[1]) - 1: parts(pad, "net")[0][2] for pad in pads if parts(pad, "net")}
    assert len(pads) == 58
    assert nets == {put: str(site) for site, put in enumerate(wiring)}
    # Two connectors of 29 contacts each, with a gap between them.
    x_mm = np.array([numbers(pad, "at")[0] for pad in pads])
    np.testing.assert_allclose(np.diff(x_mm), [0.5] * 28 + [2.5] + [0.5] * 28)


def test_a_board_that_may_have_tracks_is_not_replaced(program_here, tmp_path):
    program_here("profiles show line-7 --kicad made").fine()
    (board,) = (tmp_path / "made").iterdir()
    board.write_text("tracks")
    done = program_here("profiles show line-7 --kicad made")
    assert (done.returncode, board.read_text()) == (2, "tracks")
    assert "line-7.kicad_pcb exists" in done.stderr


def test_points_have_no_copper(program_here, tmp_path):
    text = as_toml(st.load_profile("smarttouch-4x4").with_electrodes([(0, 0), (2, 0), (1, 2)]))
    (tmp_path / "points.toml").write_text(text.replace('"disc"', '"point"'), encoding="utf-8")
    done = program_here("profiles show points.toml --svg made.svg")
    assert (done.returncode, "no copper" in done.stderr) == (2, True)
    assert not (tmp_path / "made.svg").exists()
