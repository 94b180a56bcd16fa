"""Every numeric option of every command takes any input, or refuses it in one sentence."""

import inspect
import os
import random
import signal
import socket
import subprocess
import typing
from pathlib import Path

import pytest

from smarttouch.cli import app

from ..forks import PROGRAM, Forked

pytestmark = pytest.mark.usefixtures("patient_boards")

RUNS = int(os.environ.get("SMARTTOUCH_NUMBERS", "12"))
"""How many of all pairs of an option and a number are tried; 0 is all."""
NUMBERS = (
    "nan", "inf", "-inf", "-1", "0", "-0.0", "1", "0.5", "3", "1e30", "-1e30", "1e-30", "1e308",
    "1e400", "", " ", "9" * 30, "-" + "9" * 30, "9" * 5000, "2147483648", "65536", "１",
)  # fmt: skip


def free_port():
    """Return a free TCP port of this machine."""
    with socket.create_server(("127.0.0.1", 0)) as one:
        return one.getsockname()[1]


SMALL = "--profile smarttouch-4x4"
PAGE = "--seconds 0.2 --board memory:"
BASES = {
    "live": f"live text:i {SMALL} {PAGE}",
    "read": f"read text:i {SMALL} {PAGE}",
    "braille": "braille hello",
    "braille-display": f"braille-display {free_port()} {SMALL} {PAGE}",
    "replay": f"replay {{golden}} {PAGE}",
    "design": "design --profile line-7",
    "profiles new": "profiles new mine.toml --grid 2x2 --overwrite",
    "experiment run": (
        "experiment run detection?trials=1&procedure=questplus --simulate first --subject x"
    ),
    "experiment fit": "experiment fit {answers}",
    "devices test": "devices test emulator: --profile line-7 --seconds 0.05",
    "calibrate scale": "calibrate scale emulator: --volts 1 --ohm 1000",
    "devices show": "devices show text:i --seconds 0.1",
    "calibrate registration": "calibrate registration --simulate --output mine.toml --overwrite",
    "calibrate force": "calibrate force --simulate --output mine.toml --overwrite",
    "calibrate thresholds": (
        f"calibrate thresholds --simulate {SMALL} --electrodes 0 --repeats 1 --output felt.toml "
        "--overwrite"
    ),
    "calibrate contact": (
        f"calibrate contact --board emulator: {SMALL} --output contact.toml --overwrite"
    ),
}
"""A command line of each command that has numbers, to which one is added."""

PATIENCE_S = float(os.environ.get("SMARTTOUCH_PATIENCE_S", "2"))
ENDING_S = 10


def commands(typer_app, path=()):
    for each in typer_app.registered_commands:
        yield " ".join((*path, each.name or each.callback.__name__.replace("_", "-"))), each
    for each in typer_app.registered_groups:
        yield from commands(each.typer_instance, (*path, each.name))


def numeric_options(command):
    hints = typing.get_type_hints(command.callback, include_extras=True)
    for name in inspect.signature(command.callback).parameters:
        kind, *notes = typing.get_args(hints[name]) or (hints[name],)
        if {int, float} & {kind, *typing.get_args(kind)}:
            declared = [each for note in notes for each in getattr(note, "param_decls", None) or ()]
            yield next(iter(declared), "--" + name.replace("_", "-"))


OPTIONS = [(name, each) for name, found in commands(app) for each in numeric_options(found)]


def chosen_runs():
    pairs = [(name, option, each) for name, option in OPTIONS for each in NUMBERS]
    return random.Random(RUNS).sample(pairs, RUNS) if RUNS else pairs


def test_every_command_with_numbers_is_tried():
    assert {name for name, _ in OPTIONS} == set(BASES)
    assert len(OPTIONS) > 25


def one_run(folder, arguments, patience_s=PATIENCE_S):
    """Return exit status and errors of a run, and how often one that goes on was interrupted."""
    streams = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    with Forked(
        [PROGRAM, *arguments], cwd=folder, stdin=subprocess.DEVNULL, start_new_session=True,
        text=True, errors="replace", **streams,
    ) as process:  # fmt: skip
        # Twice, as anyone would: this is not the test of what a single Ctrl-C does.
        for interrupted, wait_s in enumerate((patience_s, ENDING_S, ENDING_S)):
            try:
                out, err = process.communicate(timeout=wait_s)
            except subprocess.TimeoutExpired:
                # As a terminal does; in the end whatever it takes.
                os.killpg(process.pid, signal.SIGINT if interrupted < 2 else signal.SIGKILL)
            else:
                assert "Traceback" not in out, (arguments, out)
                return process.returncode, err, interrupted
    raise AssertionError(f"it could not be interrupted: {arguments}")


def assert_in_order(arguments, code, err, interrupted):
    """Check that a run did nothing that no run may do."""
    done = arguments, code, err
    for sign in ("Traceback", "internal error", "Warning", "Exception"):
        assert sign not in err, done
    assert code in ((0, 130) if interrupted else (0, 2)), done
    assert err or code != 2, done
    assert not err.startswith("smarttouch: ") or err.count("\n") == 1, done


@pytest.mark.timeout(0)
def test_numbers(tmp_path):
    answers = tmp_path / "answers.csv"
    answers.write_text("standard,comparison,correct\n" + "1,0.5,0\n1,1,1\n1,2,1\n" * 9)
    golden = Path(__file__).parent.parent / "running" / "goldens" / "ra.mcap"
    bases = {
        name: base.format(golden=golden, answers=answers).split() for name, base in BASES.items()
    }
    runs = chosen_runs()
    for name, base in bases.items():
        if name in {name for name, _, _ in runs}:
            code, err, interrupted = one_run(tmp_path, base, 100)
            assert (code, interrupted) == (0, 0), (base, err)
            assert_in_order(base, code, err, interrupted)
    for name, option, number in runs:
        base = list(bases[name])
        if option in base:
            at = base.index(option)
            del base[at : at + 2]
        arguments = [*base, f"{option}={number}"]
        assert_in_order(arguments, *one_run(tmp_path, arguments))
