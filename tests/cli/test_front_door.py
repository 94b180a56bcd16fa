"""The command line itself: version, help, completion, standard input."""

import collections
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from smarttouch.base.errors import SmartTouchError
from smarttouch.cli import app
from smarttouch.cli.options import or_standard_input


def as_module(*arguments, given=None, **environment):
    return subprocess.run(
        [sys.executable, "-m", "smarttouch", *arguments], env=os.environ | environment,
        input=given, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


def test_the_module_and_its_version():
    done = as_module("--version")
    name, version = done.stdout.split()
    assert (done.returncode, done.stderr, name) == (0, "", "smarttouch")
    assert version[0].isdecimal()


def test_short_help_is_the_long_one_everywhere(program_here):
    for command in ("", "live", "calibrate optics"):
        short, long = program_here(f"{command} -h"), program_here(f"{command} --help")
        assert (short.returncode, short.stdout) == (0, long.stdout)


def commands(command=None, path=()):
    """Yield the words and the object of every command and group."""
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
VERBS = {
    "Add", "Allow", "Ask", "Average", "Be", "Calculate", "Change", "Check", "Choose", "Clear",
    "Compare", "Compute", "Design", "Draw", "Drive", "Emulate", "End", "Find", "Fit", "Give",
    "Install", "Judge", "Keep", "Leave", "Let", "List", "Look", "Measure", "Move", "Name", "Open",
    "Optimize", "Play", "Print", "Put", "Raise", "Read", "Record", "Repeat", "Replace", "Rest",
    "Run", "Say", "Scale", "Search", "Send", "Serve", "Set", "Show", "Simulate", "Start", "State",
    "Stay", "Take", "Touch", "Translate", "Turn", "Use", "Walk", "Watch", "Write",
}  # fmt: skip
"""Verbs that help begins with: what the program then does, as a sentence."""
MOST_WORDS = 26


def test_commands_and_options_can_be_surveyed():
    leaves = {name for name, each in COMMANDS.items() if not hasattr(each, "commands")}
    assert len(leaves) <= 24
    assert len({name.partition(" ")[0] for name in leaves}) <= 16
    counts = collections.Counter(name for name, _ in OPTIONS if name)
    assert max(counts.values()) <= 18
    assert sum(counts.values()) <= 160


@pytest.mark.parametrize("name", COMMANDS)
def test_help_is_made_of_sentences(name):
    command = COMMANDS[name]
    told = [each.help for each in command.params if each.param_type_name == "option"]
    for help_ in (command.help, *told):
        words = " ".join(help_.split("\n\n")[0].split())
        assert words.split()[0] in VERBS, words
        assert words.endswith("."), words
        assert len(words.split()) <= MOST_WORDS, words


@pytest.mark.parametrize("name", COMMANDS)
def test_help_is_plain_and_short(program_here, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "80")
    short = program_here(f"{name} --help").fine().stdout
    assert short.isascii() or not re.search("[\u2500-\u257f\x1b]", short)
    assert max(map(len, short.splitlines())) <= 80
    for each in COMMANDS[name].params:
        if each.param_type_name == "option" and not each.hidden:
            assert each.opts[0] in short


def test_completion_has_the_commands():
    done = as_module(
        _SMARTTOUCH_COMPLETE="complete_bash", COMP_WORDS="smarttouch ca", COMP_CWORD="1"
    )
    assert (done.returncode, done.stdout.split()) == (0, ["calibrate"])


def test_a_text_from_standard_input(program):
    given = as_module("braille", "-", given="hello")
    assert given.stdout == program("braille", "hello").stdout
    read = program("read", "-", "--board", "memory:", "--seconds", "0.2", given="hello")
    assert (read.returncode, read.stderr) == (0, "")
    assert program("braille", "-", given="").returncode == 2


class Context:
    """A command's context as `or_standard_input` needs it."""

    def with_resource(self, resource):
        self.resource = resource
        return resource.__enter__()


@pytest.mark.parametrize("data", [b"%PDF-1.7", "Ünd".encode(), b"<!DOCTYPE html><p>a</p>"])
def test_standard_input_is_a_file(monkeypatch, data):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
    context = Context()
    path = Path(or_standard_input(context, "-"))
    assert (path.name, path.read_bytes()) == ("standard input", data)
    context.resource.__exit__(None, None, None)
    assert not path.exists()


def test_nothing_on_standard_input(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(SmartTouchError, match="standard input"):
        or_standard_input(Context(), "-")
