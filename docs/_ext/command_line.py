"""Writes the reference of the command line from the program itself, before pages are read."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer import Context
from typer.core import TyperGroup
from typer.main import get_command

HEAD = """\
# The command line

Made from the program: `smarttouch COMMAND --help-all` says the same. What a user can cause ends in
one sentence and exit status 2; a signal ends with all electrodes at zero and 128 plus its number.

"""


def command_line() -> str:
    """Return the page, in Markdown."""
    from smarttouch.cli import app

    return HEAD + "".join(_described(get_command(app), "smarttouch", None))


def _described(command: Any, name: str, above: Context | None) -> Iterator[str]:
    context = Context(command, info_name=name, parent=above)
    if above is not None:
        # A heading for each command, one smaller for those below it.
        full = context.command_path
        yield f"\n{'#' * full.count(' ')}# `{full}`\n\n"
        yield f"{_plain(command.help or '')}\n\n"
        yield f"```text\n{full} {' '.join(command.collect_usage_pieces(context))}\n```\n\n"
    for parameter in command.get_params(context):
        found = parameter.get_help_record(context)
        if found is not None and "--help" not in parameter.opts:
            yield f"`{found[0]}`\n: {_plain(found[1]) or '…'}\n\n"
    if isinstance(command, TyperGroup):
        for each in command.list_commands(context):
            yield from _described(command.get_command(context, each), each, context)


def _plain(text: str) -> str:
    """Return help as Markdown shows it: nothing in it is markup but what stands in quotes."""
    for mark in "\\*_<>[]$|":
        text = text.replace(mark, "\\" + mark)
    return text.replace("``", "`")


def write(app: Any) -> None:
    """Write the page where Sphinx looks for it, if it has changed."""
    path, text = Path(app.srcdir) / "reference" / "command-line.md", command_line()
    if not path.exists() or path.read_text("utf-8") != text:
        path.write_text(text, encoding="utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Take part in a build."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}
