"""Tests of the command line as a whole: version, help, completion, standard input."""

import collections
import re
import subprocess
import sys

import pytest
import typer

from smarttouch.cli import app


def test_the_module_and_its_version():
    command = [sys.executable, "-m", "smarttouch", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    name, version = done.stdout.split()
    assert (done.returncode, done.stderr, name) == (0, "", "smarttouch")
    assert version[0].isdecimal()


def commands(command=None, path=()):
    """Yield the name and the object of each command and of each group of commands."""
    command = command or typer.main.get_command(app)
    yield " ".join(path), command
    for name, each in getattr(command, "commands", {}).items():
        yield from commands(each, (*path, name))


COMMANDS = dict(commands())
OPTIONS = [
    (name, each)
    for name, command in COMMANDS.items()
    for each in command.params
    if each.param_type_name == "option"
]


def test_commands_and_options_can_be_surveyed():
    leaves = {name for name, each in COMMANDS.items() if not hasattr(each, "commands")}
    assert len(leaves) <= 24
    assert len({name.partition(" ")[0] for name in leaves}) <= 16
    counts = collections.Counter(name for name, _ in OPTIONS if name)
    assert max(counts.values()) <= 18
    assert sum(counts.values()) <= 160


@pytest.mark.parametrize("name", COMMANDS)
def test_help_is_plain_and_short(program_here, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "80")
    short = program_here(f"{name} --help").fine().stdout
    assert short.isascii() or not re.search("[\u2500-\u257f\x1b]", short)
    assert max(map(len, short.splitlines())) <= 80
    for each in COMMANDS[name].params:
        if each.param_type_name == "option" and not each.hidden:
            assert each.opts[0] in short


def test_completion_has_the_commands(program, monkeypatch):
    monkeypatch.setenv("_SMARTTOUCH_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "smarttouch ca")
    monkeypatch.setenv("COMP_CWORD", "1")
    done = program()
    assert (done.returncode, done.stdout.split()) == (0, ["calibrate"])


def test_a_text_from_standard_input(program):
    given = program("braille", "-", given="hello")
    assert given.stdout == program("braille", "hello").stdout != ""
    read = program("read", "-", "--board", "memory:", "--seconds", "0.2", given="hello")
    assert (read.returncode, read.stderr) == (0, "")
    assert program("braille", "-", given="").returncode == 2
