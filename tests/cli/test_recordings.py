"""Recordings from the command line: summarized and checked."""

import re

import pytest
import typer
from typer.testing import CliRunner

from smarttouch.cli.live import replay


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
    app.command()(replay)

    def run(*arguments):
        return CliRunner().invoke(app, [str(each) for each in arguments], env={"COLUMNS": "200"})

    return run


def test_info_has_what_an_ethics_board_asks(call, recording):
    done = call(recording, "--info")
    assert done.exit_code == 0
    for told in (
        "2023-11-14 22:13:20 UTC", "1.5 s", "nobody", "electric-mouse", "SAI 38", "mA",
        "smarttouch 1.0.0rc1", "0.06 MB", "0.600 s  intensity 0.40", "paused",
    ):  # fmt: skip
        assert told in done.stdout


def test_damage_is_reported(call, recording):
    content = recording.read_bytes()
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 1
    for broken, state in ((content, "whole"), (content[:-200], "cut:"), (flipped, "damaged:")):
        recording.write_bytes(broken)
        done = call(recording, "--info")
        assert done.exit_code == 0
        assert done.stdout.split()[:2] == ["state", state]
        assert "electric-mouse" in done.stdout


def test_a_check_that_holds_and_one_that_does_not(call, recording, tmp_path):
    done = call(recording, "--check")
    assert done.exit_code == 0
    assert re.fullmatch(r"38 .*\d+ .*\n", done.stdout)
    from smarttouch.base.files import data_folder

    text = (data_folder("calibration") / "electric-mouse.toml").read_text()
    assert "ramp_s = 0.5" in text
    other = tmp_path / "other.toml"
    other.write_text(text.replace("ramp_s = 0.5", "ramp_s = 0.6"))
    done = call(recording, "--check", "--profile", other)
    assert done.exit_code == 1
    head, *differences = done.stdout.splitlines()
    assert head.startswith("38 ")
    assert len(differences) > 1
    assert differences[0].startswith("frame 0 at ")
