"""Short runs of benchmarks, and their tables as Markdown at the end of a run.

Long, with the figures that README shows: ``pytest tests/benchmarks --benchmark-only -n0``.
Short, each path and assertion but those on speed: ``pytest tests/benchmarks --quick -n0``.
"""

import contextlib
import subprocess
import sys

import pytest


@pytest.fixture(scope="session")
def quick(request):
    """True where counts and sizes are cut and nothing is said of speed."""
    return request.config.getoption("quick")


@pytest.fixture
def row(benchmark, record_property):
    """Return a writer of table rows: a table's title, and a cell for each column.

    The tables of all tests are printed at the end.
    """
    # Nothing of its own is timed, but it counts as a benchmark.
    benchmark.pedantic(lambda: None, rounds=1)
    return lambda title, cells: record_property(
        "row", (title, {key: str(value) for key, value in cells.items()})
    )


@pytest.fixture(scope="session")
def hog():
    """Return a context in which as many other processes only burn time."""

    @contextlib.contextmanager
    def keep_busy(processes=1):
        command = [sys.executable, "-c", "while True: pass"]
        with contextlib.ExitStack() as stack:
            for _ in range(processes):
                process = stack.enter_context(subprocess.Popen(command))
                stack.callback(process.kill)
            yield

    return keep_busy


def pytest_terminal_summary(terminalreporter):
    tables = {}
    for outcome in ("passed", "failed"):
        for report in terminalreporter.getreports(outcome):
            for name, value in report.user_properties:
                if name == "row":
                    title, cells = value
                    tables.setdefault(title, []).append(cells)
    for title, rows in tables.items():
        columns = list(dict.fromkeys(column for cells in rows for column in cells))
        lines = [columns, ["---"] * len(columns)]
        lines += [[cells.get(column, "") for column in columns] for cells in rows]
        terminalreporter.write_line(f"\n**{title}**\n")
        for cells in lines:
            terminalreporter.write_line(f"| {' | '.join(cells)} |")
