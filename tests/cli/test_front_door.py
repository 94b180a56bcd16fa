"""The command line itself: version, help, completion, standard input."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from smarttouch.base.errors import SmartTouchError
from smarttouch.cli import app
from smarttouch.cli.source_options import or_standard_input


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


def test_no_help_is_longer_than_seventy_lines(program_here, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    for command in ("live", "read", "experiment run", "replay"):
        done = program_here(f"{command} -h").fine()
        assert done.stdout.count("\n") <= 70, command


def test_the_help_has_every_command_in_a_panel():
    panels = {each.rich_help_panel for each in (*app.registered_commands, *app.registered_groups)}
    assert len(panels) == 7
    assert all(isinstance(panel, str) for panel in panels)


def test_completion_knows_the_commands():
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

    def __init__(self):
        self.meta = {}

    def with_resource(self, resource):
        self.resource = resource
        return resource.__enter__()


@pytest.mark.parametrize(("data", "ending"), [
    (b"%PDF-1.7", ".pdf"), (b"\x89PNG\r\n", ".png"), (b"\xff\xd8\xff\xe0", ".jpg"),
    (b"II*\0", ".tif"), (b'<?xml version="1.0"?><pef>', ".pef"), ("Ünd".encode(), ".txt"),
])  # fmt: skip
def test_what_standard_input_holds_is_found_out(monkeypatch, data, ending):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
    context = Context()
    path = Path(or_standard_input(context, "page:-?dpi=300")[len("page:") : -len("?dpi=300")])
    assert (path.suffix, path.read_bytes()) == (ending, data)
    context.resource.__exit__(None, None, None)
    assert not path.exists()


@pytest.mark.parametrize("given", [None, "a-b.txt", "--", "-1", "text:-", "-?x"])
def test_other_names_are_left_alone(given):
    assert or_standard_input(None, given) == given


def test_nothing_on_standard_input(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(SmartTouchError) as raised:
        or_standard_input(Context(), "-")
    assert raised.value.about == "standard input"
