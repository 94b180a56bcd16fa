"""Every numeric option of every command takes whatever it is given, or says no in one sentence."""

import inspect
import os
import random
import typing
from pathlib import Path

import pytest

from smarttouch.cli import app

from .many_runs import many_runs, what_is_wrong

RUNS = int(os.environ.get("SMARTTOUCH_NUMBERS", "24"))
"""How many of all pairs of an option and a number are tried; 0 is all."""
NUMBERS = (
    "nan", "inf", "-inf", "-1", "0", "-0.0", "1", "0.5", "3", "1e30", "-1e30", "1e-30", "1e308",
    "1e400", "", " ", "9" * 30, "-" + "9" * 30, "9" * 5000, "2147483648", "65536", "１",
)  # fmt: skip

PAGE = "--seconds 0.2 --board memory: --quiet"
BASES = {
    "live": f"live --sensor text:i {PAGE}",
    "read": f"read text:i {PAGE}",
    "braille": "braille hello",
    "legibility": "legibility text:touch",
    "mouse": f"mouse --texture text:I {PAGE}",
    "color": f"color tone:40Hz,8um {PAGE}",
    "replay": f"replay {{golden}} {PAGE}",
    "design": "design --profile line-7",
    "figures": "figures pictures --profile line-7",
    "finger": "finger T --profile smarttouch-4x4 --anatomy paper",
    "experiment run": (
        "experiment run detection --simulate first --participant x --trials 1 "
        "--procedure questplus --output answers.csv --overwrite --board simulated:"
    ),
    "experiment free": f"experiment free --output free.csv {PAGE}",
    "experiment fit": "experiment fit {answers} --samples 100",
    "board test": "board test emulator: --profile line-7 --seconds 0.05",
    "board calibrate-scale": "board calibrate-scale emulator: --volts 1 --ohm 1000",
    "board emulate": "board emulate link",
    "sensor show": "sensor show text:i --seconds 0.1",
    "sensor emulate": "sensor emulate hx711",
    "calibrate optics": "calibrate optics --simulate --output mine.toml --overwrite",
    "calibrate registration": "calibrate registration --simulate --output mine.toml --overwrite",
    "calibrate force": "calibrate force --simulate --output mine.toml --overwrite",
    "calibrate thresholds": (
        "calibrate thresholds --simulate --electrodes 0 --output mine.toml --overwrite"
    ),
    "calibrate contact": "calibrate contact --board emulator: --output mine.toml --overwrite",
}
"""A command line of each command that has numbers, to which one is added."""

LONG = ("figures", "board emulate", "sensor emulate")
"""Commands that go on, or draw for half a minute."""


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
            declared = [each for note in notes for each in getattr(note, "param_decls", ())]
            yield next(iter(declared), "--" + name.replace("_", "-"))


OPTIONS = [(name, each) for name, found in commands(app) for each in numeric_options(found)]


def chosen_runs():
    pairs = [(name, option, each) for name, option in OPTIONS for each in NUMBERS]
    return random.Random(RUNS).sample(pairs, RUNS) if RUNS else pairs


def test_every_command_with_numbers_is_tried():
    assert {name for name, _ in OPTIONS} == set(BASES)
    assert len(OPTIONS) > 60


@pytest.mark.timeout(0)
def test_numbers(tmp_path):
    answers = tmp_path / "answers.csv"
    answers.write_text("standard,comparison,correct\n" + "1,0.5,0\n1,1,1\n1,2,1\n" * 9)
    golden = Path(__file__).parent.parent / "recording" / "goldens" / "ra.mcap"
    bases = {
        name: base.format(golden=golden, answers=answers).split() for name, base in BASES.items()
    }
    quick = [each for name, each in bases.items() if name not in LONG]
    for done in many_runs(tmp_path, quick, SMARTTOUCH_PATIENCE_S="100"):
        assert (done["code"], done["ended_by"], what_is_wrong(done)) == (0, None, None), done
    runs = []
    for name, option, number in chosen_runs():
        base = list(bases[name])
        if option in base:
            at = base.index(option)
            del base[at : at + 2]
        runs.append([*base, f"{option}={number}"])
    assert not [bad for done in many_runs(tmp_path, runs) if (bad := what_is_wrong(done))]
