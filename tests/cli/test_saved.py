"""``--save NAME`` keeps the settings of a command, ``--as NAME`` uses them."""

import inspect
import json
from dataclasses import fields

import pytest

from smarttouch.cli.live import live
from smarttouch.cli.saved import as_options
from smarttouch.errors import SavedRunError
from smarttouch.running.config import RunConfig
from smarttouch.running.saved import (
    SavedOptions,
    SavedRun,
    load_options,
    load_run,
    save_options,
    save_run,
    saved_run_path,
)

from .conftest import refused, says

SHORT = ("--board", "simulated:", "--sensor", "text:oo", "--profile", "line-7", "--seconds", "0.4")


@pytest.fixture(autouse=True)
def own_settings(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


def figures(done, tmp_path):
    assert done.returncode == 0, done.stderr
    return json.loads((tmp_path / "run.json").read_text())


def test_what_is_kept_is_what_was_given(program, tmp_path):
    options = (
        "--rate",
        "40",
        "--mode",
        "sai",
        "--speed",
        "30",
        "--seed",
        "3",
        "--intensity",
        "0.5",
    )
    done = program("live", *SHORT, *options, "--quiet", "--save", "desk")
    assert done.returncode == 0, done.stderr
    assert load_run("desk") == SavedRun(
        source="text:oo",
        board="simulated:",
        profile="line-7",
        source_options={"speed_mm_s": 30.0, "seed": 3},
        config=RunConfig(mode="SAI", rate_hz=40.0, seconds=0.4, seed=3),
    )
    kept = figures(program("live", "--as", "desk", "--json", "run.json"), tmp_path)
    typed = figures(program("live", *SHORT, *options, "--json", "run.json"), tmp_path)
    assert kept["sequences"] == typed["sequences"]


def test_options_beside_it_win(program, tmp_path):
    save_run("desk", SavedRun(source="text:oo", board="simulated:", profile="line-7",
                              config=RunConfig(rate_hz=40.0, seconds=0.5)))  # fmt: skip
    kept = figures(program("live", "--as", "desk", "--json", "run.json"), tmp_path)
    done = program("live", "--rate", "20", "--as", "desk", "--json", "run.json", "--save", "slow")
    slower = figures(done, tmp_path)
    assert slower["sequences"] == pytest.approx(kept["sequences"] / 2, abs=1)
    assert load_run("slow").config.rate_hz == 20
    assert load_run("slow").config.seconds == 0.5
    # What is used may be replaced, anything else not.
    assert program("live", "--as", "slow", "--rate=30", "--save", "slow").returncode == 0
    assert load_run("slow").config.rate_hz == 30
    refused = program("live", "--as", "slow", "--save", "desk")
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
    assert load_run("desk").config.rate_hz == 40


def test_on_a_real_board_intensity_is_given_anew(program_here):
    save_run("desk", SavedRun(board="link:/dev/nothing", config=RunConfig(intensity=1.0)))
    done = program_here("live", "--as", "desk")
    assert done.returncode == 2
    assert "intensity" in done.stderr


@pytest.mark.parametrize("name", ["nobody", "../x"])
def test_what_is_not_kept_is_one_sentence(program_here, name):
    done = program_here("live", "--as", name)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1


def test_what_cannot_be_opened_is_not_kept(program_here, tmp_path):
    done = program_here("live", "--sensor", "page:none.png", "--save", "desk")
    assert done.returncode == 2
    assert not (tmp_path / "config").exists()


def test_every_setting_has_its_option():
    options = {"speed_mm_s": 20.0, "size": (640, 480), "unpaced": True}
    config = RunConfig(rate_hz=40.0, seconds=1.0, softness=0.5, hold="charge", seed=3)
    given = as_options(
        SavedRun(source="a:", board="b:", vibrators="c:", force="d:", profile="e",
                 source_options=options, config=config)
    )  # fmt: skip
    assert given.keys() <= inspect.signature(live).parameters.keys()
    assert (given["size"], given["speed_mm_s"], given["source"]) == ("640x480", 20.0, "a:")
    # Intensity is never kept, and a tone has no option: `live` takes it from the file.
    known = dict.fromkeys(("intensity", "tone"), "mode")
    assert {known.get(each.name, each.name) for each in fields(RunConfig)} <= given.keys()


NOWHERE = ("--board", "simulated:", "--quiet", "--intensity", "0.5")
WHOLE = {
    "read": (("text:a", "--speed", "400", "--pause", "0"), {"speed_mm_s": 400.0, "pause_s": 0.0}),
    "mouse": (("--texture", "grating:3mm", "--seconds", "0.1"), {"texture": "grating:3mm"}),
    "color": (("tone:30Hz,8um", "--seconds", "0.2", "--seed", "3"), {"seed": 3}),
    "braille": (("ab", "--columns", "9", "--leave-out"), {"source": "ab", "columns": 9}),
    "experiment run": (
        ("frequency", "--simulate", "first", "--standards", "30", "--train-s", "0.1",
         "--repetitions", "1", "--overwrite", "--gap-s", "0.1"),
        {"name": "frequency", "simulate": "first", "repetitions": 1},
    ),
}  # fmt: skip


@pytest.mark.parametrize("command", WHOLE)
def test_every_command_keeps_its_settings(program_here, command):
    given, kept = WHOLE[command]
    use = "--settings" if command == "read" else "--as"
    run = () if command == "braille" else NOWHERE
    done = program_here(*command.split(), *given, *run, "--save", "desk")
    assert done.returncode == 0, done.stderr
    known = {*kept, *(each.lstrip("-").replace("-", "_") for each in given), "board", "source"}
    found = load_options("desk", command, known)
    assert kept.items() <= found.items()
    assert not {"intensity", "quiet", "overwrite", "save"} & found.keys()
    again = ("--overwrite",) if command == "experiment run" else ()
    used = program_here(*command.split(), use, "desk", *again, *run[2:3], "--save", "desk")
    assert used.returncode == 0, used.stderr
    assert load_options("desk", command, known) == found
    assert done.stdout == used.stdout


def test_files_of_kept_options_are_found_from_anywhere(program_here, tmp_path):
    (tmp_path / "words.txt").write_text("ab")
    assert program_here("braille", "words.txt", "--save", "desk").returncode == 0
    assert load_options("desk", "braille", ["source"]) == {"source": str(tmp_path / "words.txt")}


def test_what_a_file_of_options_cannot_say(program_here):
    about = {"about": "options.intensity", "problem": "impossible", "value": 1.0}
    save_options("desk", SavedOptions(command="mouse", options={"intensity": 1.0}))
    says(SavedRunError, **about)(refused(program_here("mouse", "--as", "desk")))
    other = {"about": "command", "problem": "conflict"}
    for command, allowed in (("live", None), ("color", "color")):
        check = says(SavedRunError, **other, value="mouse", allowed=allowed)
        check(refused(program_here(command, "--as", "desk")))
    save_run("run", SavedRun(source="text:oo"))
    check = says(SavedRunError, **other, value=None, allowed="mouse")
    check(refused(program_here("mouse", "--as", "run")))


def test_standard_input_is_not_kept(program_here, monkeypatch):
    monkeypatch.setattr("smarttouch.cli.saved.is_standard_input", lambda _: True)
    done = program_here("braille", "ab", "--save", "desk")
    says(SavedRunError, about="source", problem="impossible", remedy="save")(refused(done))
    assert not saved_run_path("desk").exists()
