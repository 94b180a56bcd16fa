"""Sphinx extension that writes the command-line reference from the program's own help texts."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer import Context
from typer.core import TyperGroup
from typer.main import get_command

FOLDER = "reference/command-line"
HEAD = """\
# The command line

These pages are made from the program: `smarttouch COMMAND --help` prints the same text. After an
error that a user can cause, a command prints one sentence and exits with status 2. After a signal
it sets all electrodes to zero and exits with status 128 plus the number of the signal.

"""


def command_line() -> dict[str, str]:
    """Return Markdown pages by name: one page for each command, and an index of all commands."""
    from smarttouch.cli import app

    program = get_command(app)
    above = Context(program, info_name="smarttouch")
    listed, pages = "", {}
    for name in program.list_commands(above):
        command = program.get_command(above, name)
        first = _plain((command.help or "").split("\n\n")[0])
        listed += f"- [`smarttouch {name}`]({name}.md): {first}\n"
        pages[name] = "".join(_described(command, name, above)).lstrip()
    tree = "\n".join(pages)
    pages["index"] = f"{HEAD}{listed}\n```{{toctree}}\n:hidden:\n\n{tree}\n```\n"
    return pages


def _described(command: Any, name: str, above: Context) -> Iterator[str]:
    context = Context(command, info_name=name, parent=above)
    full = context.command_path
    # The heading of a subcommand is one level below that of its command.
    yield f"\n{'#' * full.count(' ')} `{full}`\n\n"
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
    """Escape the Markdown characters of a help text, and mark its double backquotes as code."""
    for mark in "\\*_<>[]$|":
        text = text.replace(mark, "\\" + mark)
    return text.replace("``", "`")


def write(app: Any) -> None:
    """Write the pages that have changed into Sphinx's source folder, and delete old ones."""
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(exist_ok=True)
    pages = {folder / f"{name}.md": text for name, text in command_line().items()}
    for path, text in pages.items():
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, encoding="utf-8")
    for path in set(folder.iterdir()) - set(pages):
        path.unlink()


def setup(app: Any) -> dict[str, bool]:
    """Register `write` with Sphinx, so that the pages exist before Sphinx reads its sources."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}
