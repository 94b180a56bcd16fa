"""Tests that each way to end a run sets the board to zero and prints at most one clear line."""

import json
import re
import signal
import sys

import pytest

from smarttouch import cli
from smarttouch.emulator.firmware_base import read_state
from smarttouch.running.pipeline import Pipeline

from ..boards.emulator_waits import until
from ..support.full import sample
from .conftest import PRESSED

PATIENCE_S = 60


@pytest.fixture
def running(start_program, start_emulator):
    """Return a run that delivers pulses, its emulator, and the folder of the delivery log."""
    emulator, port, books = start_emulator(64, "link", "linger=0.2")
    host = start_program(
        "live", "--board", f"link:{port}", *PRESSED, "--intensity", "1", "--json", "run.json"
    )
    until(lambda: read_state(books)["slots"] > 50)
    return host, emulator, books


def ending(host):
    output, errors = host.communicate(timeout=PATIENCE_S)
    assert "Traceback" not in errors
    return host.returncode, output, errors


@pytest.mark.parametrize(("number", "name"), sample([
    (signal.SIGINT, "Ctrl-C"), (signal.SIGTERM, "SIGTERM"), (signal.SIGHUP, "SIGHUP"),
]))  # fmt: skip
def test_signals_end_in_order(running, number, name):
    host, emulator, books = running
    host.send_signal(number)
    code, output, errors = ending(host)
    assert (code, errors) == (0, "")
    assert f"({name})" in output
    emulator.wait(PATIENCE_S)
    state = read_state(books)
    assert (state["state"], state["reason"]) == ("shorted", "stop")


@pytest.mark.realtime
def test_the_board_dies_and_its_port_with_it(start_program, start_emulator, tmp_path):
    emulator, port, books = start_emulator(64, "link", "linger=0.2")
    # Use a link to the port, because a new port can get the name of a closed port.
    name = tmp_path / "port"
    name.symlink_to(port)
    host = start_program(
        "live", "--board", f"link:{name}", *PRESSED, "--intensity", "1", "--json", "run.json"
    )
    until(lambda: read_state(books)["slots"] > 50)
    name.unlink()
    emulator.kill()
    code, _, errors = ending(host)
    assert code == 2
    assert errors.count("\n") == 1
    assert errors.startswith("smarttouch: ")
    assert str(name) in errors
    assert "100 ms" in errors
    assert json.loads((tmp_path / "run.json").read_text())["ended"] == "fault"


@pytest.mark.realtime
@pytest.mark.parametrize("stage", ["pipeline", "screen"])
def test_an_exception_in_a_stage(monkeypatch, capsys, start_emulator, stage):
    emulator, port, books = start_emulator(64, "link", "linger=0.2")
    calls = []

    def broken(*_):
        calls.append(1)
        raise RuntimeError("the stage\nbroke")

    if stage == "pipeline":
        monkeypatch.setattr(Pipeline, "warm_up", lambda _: None)
        monkeypatch.setattr(Pipeline, "process", broken)
    else:
        monkeypatch.setattr("smarttouch.views.terminal_screen.Screen.step", broken)
    monkeypatch.setattr(
        sys, "argv", ["smarttouch", "live", "--board", f"link:{port}", *PRESSED, "--intensity", "1"]
    )
    with pytest.raises(SystemExit) as caught:
        cli.main()
    errors = capsys.readouterr().err
    assert calls
    assert caught.value.code == 1
    assert errors.startswith("smarttouch: ")
    assert "RuntimeError: the stage broke" in errors
    assert re.search(r"\(\S+\.py, line \d+\)", errors)
    assert errors.count("\n") == 1
    emulator.wait(PATIENCE_S)
    assert read_state(books)["state"] == "shorted"


@pytest.mark.parametrize("file", [(), ("mine.toml",)])
def test_an_error_of_the_system_names_its_file_alone(monkeypatch, capsys, file):
    def broken(_):
        raise OSError(28, "no space", *file)

    monkeypatch.setattr("smarttouch.profile.load_profile", broken)
    monkeypatch.setattr(sys, "argv", ["smarttouch", "profiles", "show"])
    with pytest.raises(SystemExit):
        cli.main()
    assert capsys.readouterr().err.startswith(": ".join(["smarttouch", *file, "no space;"]))
