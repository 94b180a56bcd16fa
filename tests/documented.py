"""Pages as a reader goes through them: ``python -m tests.documented [PAGE ...]``, all if none is
named.

The blocks of a page (`console`, `sh`, `bash`, `python`, and files that it names) are run in their
order, in an empty folder with the files that they read (`tests/page_files.py`); what fails is told
by page and line. Unlike a reader's: commands that run until somebody ends them have the `SHORT`
options added, devices and places have `STAND_INS`, BRLTTY is waited for at a free port, what would
set up an environment (`ENVIRONMENT`) is left out, and a command that fails is tried again
(`TRIES`). What an `output` block says right after such a block must have been printed, but for its
numbers and what `…` stands for. A comment before a block says what of it is not run:
``<!-- not run: "text in a line", "text in another": why -->``.
"""

import argparse
import contextlib
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from .forks import PROGRAM
from .installed import install_project
from .page_files import make_named

ROOT = Path(__file__).parent.parent
GENERATED = ROOT / "docs/reference/command-line"
"""Pages that `docs/_ext/command_line.py` makes when the documentation is built."""
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if GENERATED not in page.parents),
]
LONGEST_S = 300
TRIES = 3
"""Of a command that fails: boards go to zero beneath a machine that is too busy for them."""

SHORT = {
    "live": "--seconds 1",
    "read": "--seconds 1",
    "braille-display": "--seconds 1",
    "replay": "--seconds 1",
    "experiment run free": "--seconds 1",
    "experiment run gap.py": "--board simulated:",
    "experiment run": "--simulate model --board simulated:",
    "calibrate thresholds": "--simulate --electrodes 0 --repeats 1",
    "calibrate force": "--simulate",
    "calibrate registration": "--simulate",
    "calibrate optics": "--simulate",
    "devices test": "--seconds 0.1",
    "calibrate scale": "--volts 1.0",
}
"""Options that are added to a command, where it has not got them."""
NOT_WITH = {"replay": "--check", "live": "text:Hello"}
"""A word beside which none is added: such a command ends by itself."""

STAND_INS = {"URL": "emulator:", "PORT": "emulator:", "camera:0": "video:clip.mp4"}
EMULATED = {
    "/dev/ttyUSB0": ("devices", "emulate", "kajimoto61?port_only"),
    "/dev/ttyACM0": ("devices", "emulate", "etactilekit?port_only"),
    "/dev/ttyUSB1": ("devices", "emulate", "hx711?port_only"),
}
"""Devices, and the commands that play them: their ports stand for them."""
ENVIRONMENT = ("python3 -m venv", ".venv/bin/pip", ". .venv/bin/", "pip install", "mkdir", "cd ")
"""Beginnings of commands that the environment and the folder of a page stand for."""

_PART = re.compile(
    r"(?:<!-- not run: (?P<not_run>.*?) -->\n+)?^```(?P<language>\w+)\n(?P<text>.*?)^```$"
    r"|^(?:Save this as )?`(?P<file>[\w.]+)`(?=[,:])",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Block:
    """A block of a page: its first line, the name that the page gives it (or none), its text, and
    parts of lines that are not run.
    """

    page: Path
    line: int
    language: str
    text: str
    file: str = ""
    not_run: tuple[str, ...] = ()

    def commands(self) -> Iterator[tuple[int, list[str], bool]]:
        """Yield the line, words, and whether it is run, of each command of a shell's block."""
        if self.language not in ("sh", "console", "bash"):
            return
        for number, line in enumerate(self.text.splitlines(), self.line):
            runs = not any(part in line for part in self.not_run)
            for part in line.removeprefix("$ ").split("&&"):
                if words := shlex.split(part, comments=True):
                    yield number, words, runs


def blocks(page: Path) -> Iterator[Block]:
    """Yield the blocks of a page, in order."""
    text, file = page.read_text("utf-8"), ""
    for part in _PART.finditer(text):
        if part["file"]:
            file = part["file"]
            continue
        line = text.count("\n", 0, part.start("text")) + 1
        not_run = tuple(re.findall(r'"([^"]+)"', part["not_run"] or ""))
        code = part["language"] in ("python", "toml")
        yield Block(page, line, part["language"], part["text"], file if code else "", not_run)
        file = ""


def _without_numbers(text: str) -> str:
    return " ".join(re.sub(r"[-+−]?\d[\d.,]*", "0", text).split())


def _free_place(words: list[str]) -> list[str]:
    """Return a command's words with a free port for BRLTTY's usual one, which others may have."""
    name, *rest = words or [""]
    if name != "braille-display":
        return words
    with socket.create_server(("127.0.0.1", 0)) as one:
        address = f"listen:{one.getsockname()[1]}"
    return [name, address, *(rest[1:] if rest and not rest[0].startswith("-") else rest)]


class PageError(Exception):
    """A command or a block that did not end well."""


@dataclass
class Reader:
    """Goes through pages in a folder of its own, and starts programs as `subprocess.Popen` does."""

    folder: Path
    popen: type[subprocess.Popen] = subprocess.Popen
    done: list[list[str]] = field(default_factory=list)
    not_run: list[str] = field(default_factory=list)

    def read(self, page: Path) -> None:
        """Run all of a page; raise PageError with page and line of the first thing that fails."""
        self._place, self._cache = self.folder / "site", self.folder / "cache"
        self._here = self.folder / page.stem
        for each in (self._here, self._place):
            each.mkdir(exist_ok=True)
        self._ports: dict[str, str] = {}
        self._said = ""
        with contextlib.ExitStack() as self._stack:
            for block in blocks(page):
                self._run_block(block)

    def _run_block(self, block: Block) -> None:
        name = block.page.relative_to(ROOT)
        if block.language == "output":
            self._compare(block, f"{name}:{block.line}")
        self._said = ""
        if block.file or block.language == "python":
            self._run_file(block, f"{name}:{block.line}")
        for line, words, runs in block.commands():
            if runs:
                self._run_words(words, f"{name}:{line}")
            else:
                self.not_run.append(f"{name}:{line}: {shlex.join(words)}")
        lines = block.text.splitlines()
        for part in block.not_run:
            if not any(part in line for line in lines):
                raise PageError(f"{name}:{block.line}: nothing here has {part!r}")

    def _run_file(self, block: Block, where: str) -> None:
        """Write a file that the page names; what it does not name is run at once."""
        test = "def test_" in block.text
        path = self._here / (block.file or ("test_block.py" if test else "block.py"))
        path.write_text(block.text, encoding="utf-8")
        make_named(block.text, self._here)
        if not block.file:
            self._run_words(["pytest" if test else "python", path.name], where)

    def _run_words(self, words: list[str], where: str) -> None:
        line = " ".join(words)
        if line.startswith("pip install .") and (self._here / "pyproject.toml").exists():
            install_project(self._here, self._place)
        if line.startswith(ENVIRONMENT):
            return
        program, *rest = words
        if Path(program).name == "smarttouch":
            rest = self._short(_free_place([self._stand_in(word) for word in rest]))
            make_named(" ".join(rest), self._here)
            command = [str(PROGRAM), *rest]
        elif program == "python":
            command = [sys.executable, *rest]
        else:
            command = [sys.executable, "-m", program, *rest]
            if (self._here / "pyproject.toml").exists():
                command += ["-c", "pyproject.toml"]
        self.done.append(words)
        if "emulate" in rest:
            self._emulated(tuple(rest))
            return
        for _ in range(TRIES):
            with self._start(command, stderr=subprocess.STDOUT) as process:
                try:
                    said, _ = process.communicate(timeout=LONGEST_S)
                except subprocess.TimeoutExpired:
                    process.kill()
                    raise PageError(f"{where}: {shlex.join(words)}: did not end") from None
            if not process.returncode:
                self._said += said
                return
        raise PageError(f"{where}: {shlex.join(words)}: {process.returncode}\n{said}")

    def _compare(self, block: Block, where: str) -> None:
        """Look for each line of a block among what the block before it printed, if it was run."""
        said = _without_numbers(self._said)
        for line in block.text.splitlines() if said else ():
            for part in _without_numbers(line).split("…"):
                if part.strip() not in said:
                    raise PageError(f"{where}: not printed: {line}\n{self._said}")

    def _start(self, command: list[str], **streams: int) -> subprocess.Popen:
        environment = os.environ | {
            "XDG_CACHE_HOME": str(self._cache),
            "XDG_CONFIG_HOME": str(self._here / "config"),
            "XDG_STATE_HOME": str(self._here / "state"),
            "MPLBACKEND": "agg",
            "PYTHONPATH": os.pathsep.join([str(self._place), os.environ.get("PYTHONPATH", "")]),
            "PYTHONUNBUFFERED": "1",
        }
        keys, terminal = os.openpty()
        self._stack.callback(os.close, keys)
        try:
            return self.popen(
                command, cwd=self._here, env=environment, stdin=terminal, text=True,
                stdout=subprocess.PIPE, **streams,
            )  # fmt: skip
        finally:
            os.close(terminal)

    def _short(self, words: list[str]) -> list[str]:
        plain = [each.partition("?")[0] for each in words]
        if plain[:2] == ["experiment", "run"] and plain[2:3] not in ([], ["free"]):
            name, _, options = words[2].partition("?")
            kept = [each for each in options.split("&") if each and "repetitions" not in each]
            words = [*words[:2], f"{name}?{'&'.join([*kept, 'repetitions=1'])}", *words[3:]]
        for name, options in SHORT.items():
            if plain[: len(name.split())] == name.split() and NOT_WITH.get(name) not in words:
                first, *_ = options.split()
                if first in words:
                    return [
                        *words[: words.index(first)],
                        *words[words.index(first) + 2 :],
                        *options.split(),
                    ]
                return [*words, *options.split()]
        return words

    def _stand_in(self, word: str) -> str:
        for device, command in EMULATED.items():
            if device in word:
                if device not in self._ports:
                    self._ports[device] = self._emulated(command)
                word = word.replace(device, self._ports[device])
        return STAND_INS.get(word, word)

    def _emulated(self, words: tuple[str, ...]) -> str:
        """Start an emulator, which is ended with the page; return the first line that it says."""
        process = self._start([str(PROGRAM), *words])

        def end() -> None:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=LONGEST_S)

        self._stack.callback(end)
        return process.stdout.readline().strip()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", nargs="*", type=Path)
    pages = [path.resolve() for path in parser.parse_args().page]
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        reader = Reader(Path(folder))
        for page in pages or PAGES:
            before, start = len(reader.done), os.times()
            try:
                reader.read(page)
            except PageError as error:
                failed += 1
                print(error)
            now = os.times()
            cpu_s = sum(now[:4]) - sum(start[:4])
            if count := len(reader.done) - before:
                print(f"{page.relative_to(ROOT)}: {count} run, {cpu_s:.1f} s of processor time")
    for each in reader.not_run:
        print(f"not run: {each}")
    print(f"{len(reader.done)} run, {len(reader.not_run)} not, {failed} pages failed")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
