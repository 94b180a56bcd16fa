"""Tactile primary colors, through ``smarttouch live vibration:``."""

from pathlib import Path

import numpy as np
import pytest

from smarttouch.base.errors import ScheduleError, SmartTouchError, SourceError
from smarttouch.running.check_recording import assert_replays

from .conftest import refused, says


@pytest.fixture
def mixed(program_here):
    """Return a runner of a vibration that gives its figures, and all that was ``printed``."""

    def run(spec, more=""):
        live = f"live 'vibration:{spec}' --board simulated: --json f.json"
        done = program_here(f"{live} {more}").flawless()
        return done.figures | {"printed": done.stdout}

    return run


def test_all_three_on_an_emulated_board(mixed, tmp_path):
    # At a level at which net current leaves every class its rate.
    spec = "tone:30Hz,9um+tone:250Hz,1.5um+press:0.45N"
    figures = mixed(f"{spec}?seconds=1", "--intensity 0.3 --record r.mcap")
    assert figures["ended"] == "the end of the trace"
    assert figures["emulator_violations"] == 0
    # RA at 30 a second, PC at every second cycle, at four sites; SAI as its force has it.
    assert figures["slots"] > 4 * (28 + 120)
    assert " RA, " in " ".join(figures["printed"].split())
    assert_replays(tmp_path / "r.mcap")


def test_a_file_keeps_its_own_time_and_can_be_cut(mixed, tmp_path):
    time_s = np.arange(0, 1, 0.001)
    moved = 8 * np.sin(60 * np.pi * time_s)
    lines = [f"{time:.3f},{um:.3f}" for time, um in zip(time_s, moved, strict=True)]
    (tmp_path / "t.csv").write_text("\n".join(["time_s,displacement_um", *lines]))
    for more, lasts in (("", 1.0), ("--seconds 0.4", 0.4)):
        figures = mixed("t.csv", f"--quiet {more}")
        assert figures["seconds"] == pytest.approx(lasts, abs=0.03)
        assert figures["printed"] == ""


def test_what_is_left_out_is_reported(mixed):
    said = mixed("tone:30Hz,9um+press:1N?seconds=0.3", "--profile kajimoto-61")["printed"]
    (left_out,) = (line for line in said.splitlines() if line.split()[:2] == ["SAI", "would"])
    assert "PC" not in left_out


@pytest.mark.parametrize(("arguments", "wrong"), [
    ("tone:250Hz,2um --profile kajimoto-61", says(ScheduleError, "PC", "kajimoto-61", " RA ")),
    ("tone:30", says(SmartTouchError, "'tone:30'", "tone:30Hz,8um")),
    ("tone:30Hz,9um --mode PC", says(SourceError, about="mode")),
    ("tone:30Hz,9um --json no/f.json", says(about="file", value=Path("no/f.json"))),
])  # fmt: skip
def test_what_cannot_be_done_is_one_sentence(program_here, arguments, wrong):
    wrong(refused(program_here(f"live vibration:{arguments} --board simulated:")))
