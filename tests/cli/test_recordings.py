"""Recordings from the command line: inspected, repaired, exported, and checked."""

import re

import pytest
import typer
from typer.testing import CliRunner

from smarttouch.base.errors import RecordingError
from smarttouch.cli.recordings import recordings, replay

from .conftest import says


@pytest.fixture
def recording(tmp_path):
    """A copy of a golden that may be broken."""
    from pathlib import Path

    golden = Path(__file__).parents[1] / "running" / "goldens" / "sai-levels.mcap"
    path = tmp_path / "run.mcap"
    path.write_bytes(golden.read_bytes())
    return path


@pytest.fixture
def call():
    app = typer.Typer()
    app.add_typer(recordings, name="recordings")
    app.command()(replay)

    def run(*arguments):
        return CliRunner().invoke(app, [str(each) for each in arguments], env={"COLUMNS": "200"})

    return run


def test_info_has_what_an_ethics_board_asks(call, recording):
    done = call("recordings", "info", recording)
    assert done.exit_code == 0
    for told in (
        "2023-11-14 22:13:20 UTC", "1.5 s", "nobody", "electric-mouse", "SAI 38", "mA",
        "smarttouch 0.9.0", " kB", "/frame", "0.600 s  intensity 0.40", "paused",
    ):  # fmt: skip
        assert told in done.stdout


def test_a_cut_recording_is_reported_repaired_and_whole_again(call, recording):
    whole = call("recordings", "repair", recording)
    assert whole.exit_code == 0
    assert list(recording.parent.glob("*.mcap")) == [recording]
    state = call("recordings", "info", recording).stdout.splitlines()[0]
    recording.write_bytes(recording.read_bytes()[:-200])
    assert call("recordings", "info", recording).stdout.splitlines()[0] != state
    done = call("recordings", "repair", recording)
    assert done.exit_code == 0
    mended = recording.with_name("run-repaired.mcap")
    assert done.stdout.startswith(f"{mended}: 38 ")
    assert "1.5 s" in done.stdout
    assert call("recordings", "info", mended).stdout.splitlines()[0] == state
    again = call("recordings", "repair", recording)
    says(RecordingError, str(mended))(again.exception)
    other = call("recordings", "repair", recording, "--output", recording.with_name("other.mcap"))
    assert other.exit_code == 0


def test_export_names_what_it_wrote(call, recording, tmp_path):
    done = call("recordings", "export", recording, tmp_path / "out")
    assert done.exit_code == 0
    names = [line.rpartition("/")[2] for line in done.stdout.split()]
    assert names == ["frames", "steps.csv", "events.csv", "run.npz"]


def test_a_check_that_holds_and_one_that_does_not(call, recording, tmp_path):
    done = call("replay", recording, "--check")
    assert done.exit_code == 0
    assert re.fullmatch(r"38 .*\d+ .*\n", done.stdout)
    from smarttouch.base.files import data_folder

    text = (data_folder("calibration") / "electric-mouse.toml").read_text()
    assert "ramp_s = 0.5" in text
    other = tmp_path / "other.toml"
    other.write_text(text.replace("ramp_s = 0.5", "ramp_s = 0.6"))
    done = call("replay", recording, "--check", "--profile", other)
    assert done.exit_code == 1
    head, *differences = done.stdout.splitlines()
    assert head.startswith("38 ")
    assert len(differences) > 1
    assert differences[0].startswith("frame 0 at ")
