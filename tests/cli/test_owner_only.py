"""What programs write can be read by its owner alone, with any umask."""

import os
import stat

import pytest

LIVE = ("live", "text:oo", "--board", "simulated:", "--seconds", "0.3")
COMMANDS = {
    "run": (
        (*LIVE, "--record", "run.mcap", "--json", "run.json"),
    ),
    "felt": ((*LIVE, "--felt", "felt.png"),),
    "vibrations": ((*LIVE, "--set", "vibrators=out.wav"),),
    "experiment": (
        ("experiment", "run", "frequency?standards=30&train_s=0.15&repetitions=1&gap_s=0.1",
         "--simulate", "model", "--output", "a.csv"),
    ),
    "profile": (("calibrate", "optics", "--simulate", "--output", "mine.toml"),),
}  # fmt: skip


@pytest.mark.parametrize("name", COMMANDS)
def test_files_and_folders_of_a_command(program_here, tmp_path, monkeypatch, name):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    # Made by a library for the state of runs, with no more than their process numbers in it.
    (tmp_path / "state").mkdir()
    (tmp_path / "pictures").mkdir(mode=0o700)
    before = os.umask(0)
    try:
        for command in COMMANDS[name]:
            program_here(*command).fine()
    finally:
        os.umask(before)
    modes = {
        str(each.relative_to(tmp_path)): f"{stat.S_IMODE(each.stat().st_mode):o}"
        for each in tmp_path.rglob("*")
        if "state" not in each.parts
    }
    assert len(modes) > len(COMMANDS[name])
    assert {path: mode for path, mode in modes.items() if mode not in ("600", "700")} == {}
