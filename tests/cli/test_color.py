"""Tactile primary colors, through the program."""

import json
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from PIL import Image
from typer.testing import CliRunner

from smarttouch.base.errors import ScheduleError, SmartTouchError, SourceError
from smarttouch.cli.live import color
from smarttouch.running.check_recording import assert_replays

from ..raising import raises
from .conftest import refused, says


@pytest.fixture
def run_color(tmp_path, monkeypatch):
    """Return a runner of the command alone, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(color)

    def run(line, board="simulated:"):
        words = shlex.split(f"{line} --board {board}")
        done = CliRunner().invoke(app, words, catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return done.stdout

    return run


def rows_of(output):
    """Return the cells of a printed table by the name of the class."""
    lines = (line.split() for line in output.splitlines())
    return {cells[0]: cells[1:] for cells in lines if cells and cells[0] in {"RA", "SAI", "PC"}}


def test_split_alone_needs_no_board(run_color, tmp_path):
    said = run_color("tone:30Hz,8um+press:0.45N --split-only --json f.json --plot a.png")
    rows = rows_of(said)
    assert rows["RA"][2:] == ["30.0", "Hz", "46%"]
    assert rows["PC"] == ["0.00", "0.00", "–", "0%"]
    figures = json.loads((tmp_path / "f.json").read_text())
    assert figures["classes"]["SAI"]["answered"]["peak_drive"] == pytest.approx(0.5, abs=0.01)
    assert np.asarray(Image.open(tmp_path / "a.png").convert("L")).std() > 5


def test_all_three_on_an_emulated_board(run_color, tmp_path):
    spec = "tone:30Hz,9um+tone:250Hz,1.5um+press:0.45N"
    # At a level at which net current leaves every class its rate.
    kept = "--json f.json --record r.mcap --plot a.png"
    said = run_color(f"{spec} --seconds 1 --intensity 0.3 {kept}")
    rows = rows_of(said)
    assert rows["RA"][-6:-3] == ["29", "30.0", "Hz"]
    assert rows["PC"][-6:-3] == ["121", "125.0", "Hz"]
    figures = json.loads((tmp_path / "f.json").read_text())
    assert figures["ended"] == "the end of the trace"
    assert figures["emulator_violations"] == 0
    assert figures["color"]["sites"] == [27, 28, 35, 36]
    price = figures["color"]["pc_also_reaches"]
    assert price["classes"] == ["RA"]
    assert f" RA, {price['mean_times']:.1f} times" in " ".join(said.split())
    off_us = [each["sent"]["off_max_us"] for each in figures["color"]["classes"].values()]
    assert max(off_us) <= 2500
    assert (tmp_path / "a.png").stat().st_size > 10_000
    assert_replays(tmp_path / "r.mcap")


def test_sites_are_a_list_or_all(run_color):
    for option, sites in (("27, 28,35-36", 4), ("0", 1), ("all", 64)):
        said = run_color(f"tone:30Hz,8um --seconds 0.3 --sites '{option}'")
        assert f" {sites} sites" in said


def test_a_file_keeps_its_own_time_and_can_be_cut(run_color, tmp_path):
    time_s = np.arange(0, 1, 0.001)
    moved = 8 * np.sin(60 * np.pi * time_s)
    lines = [f"{time:.3f},{um:.3f}" for time, um in zip(time_s, moved, strict=True)]
    (tmp_path / "t.csv").write_text("\n".join(["time_s,displacement_um", *lines]))
    for more, lasts in (("", 1.0), ("--seconds 0.4", 0.4)):
        run_color(f"t.csv --json f.json --quiet {more}")
        figures = json.loads((tmp_path / "f.json").read_text())
        assert figures["seconds"] == pytest.approx(lasts, abs=0.03)


def test_nothing_is_said_when_quiet(run_color):
    assert run_color("press:1N --seconds 0.2 --quiet") == ""
    assert run_color("press:1N --split-only --quiet") == ""


def test_what_is_left_out_is_said(run_color):
    said = run_color("tone:30Hz,9um+press:1N --profile kajimoto-61 --seconds 0.3")
    (left_out,) = (line for line in said.splitlines() if line.split()[:2] == ["SAI", "would"])
    assert "PC" not in left_out


@pytest.mark.parametrize(("arguments", "wrong"), [
    ("tone:250Hz,2um --profile kajimoto-61", says(ScheduleError, "PC", "kajimoto-61", " RA ")),
    ("tone:30Hz,2um --sites a-b", says(about="sites", value="a-b")),
    ("tone:30Hz,2um --sites 64", says(ScheduleError, "site 64 ", " 0 to 63")),
    ("tone:30 --split-only", says(SmartTouchError, "'tone:30'", "tone:30Hz,8um")),
    ("tone:30Hz,9um --json no/f.json", says(about="file", value=Path("no/f.json"))),
    ("tone:30Hz,9um --intensity 2", says(about="intensity", value=2, allowed=(0, 1))),
    ("none.csv", says(SmartTouchError, "'none.csv'", "tone:30Hz,8um")),
])  # fmt: skip
def test_what_cannot_be_done_is_one_sentence(run_color, arguments, wrong):
    with pytest.raises(SmartTouchError) as caught:
        run_color(arguments)
    wrong(caught.value)


def test_without_force_there_is_no_current(run_color):
    sent = [
        rows_of(run_color(f"tone:30Hz,9um --seconds 0.3 {more}"))["RA"]
        for more in ("", "--force fixed:0.9", "--force fixed:0")
    ]
    assert [cells[-6] for cells in sent] == ["8", "8", "0"]


def test_a_finger_on_the_board_needs_a_word_on_force(run_color, monkeypatch):
    monkeypatch.setattr("smarttouch.boards.open.MemoryBoard.on_a_finger", True)
    with raises(SourceError, about="force", remedy="force"):
        run_color("tone:30Hz,9um --intensity 1", "memory:")


def test_what_is_missing_for_a_picture_is_said_before_anything_is_felt(program_here, monkeypatch):
    imported = [each for each in sys.modules if each.partition(".")[0] == "matplotlib"]
    for name in {"matplotlib", *imported}:
        monkeypatch.setitem(sys.modules, name, None)
    for name, wrong in (("a.png", ("smarttouch[plot]",)), ("a.bmp", ("a.bmp", "*.png"))):
        done = program_here(f"color tone:30Hz,8um --board simulated: --plot {name}")
        says(SmartTouchError, *wrong)(refused(done))
        assert done.stdout == ""
