"""Writes the reference of the command line from the program itself, before pages are read."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer import Context
from typer.core import TyperGroup
from typer.main import get_command

FOLDER = "reference/command-line"
HEAD = """\
# The command line

Made from the program: `smarttouch COMMAND --help` says the same. Whatever a user can cause
ends in one sentence and exit status 2; a signal ends with all electrodes at zero and 128 plus its
number.

"""


def command_line() -> dict[str, str]:
    """Return the pages by name, in Markdown: one for each command, and one that lists them."""
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
    # A heading for each command, one smaller for those below it.
    full = context.command_path
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
    """Return help as Markdown shows it: nothing in it is markup but what stands in quotes."""
    for mark in "\\*_<>[]$|":
        text = text.replace(mark, "\\" + mark)
    return text.replace("``", "`")


def write(app: Any) -> None:
    """Write the pages where Sphinx looks for them, those that have changed."""
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(exist_ok=True)
    pages = {folder / f"{name}.md": text for name, text in command_line().items()}
    for path, text in pages.items():
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, encoding="utf-8")
    for path in set(folder.iterdir()) - set(pages):
        path.unlink()


def setup(app: Any) -> dict[str, bool]:
    """Take part in a build."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}
