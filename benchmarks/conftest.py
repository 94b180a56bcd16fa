"""Tables of figures as Markdown at the end of a run: ``pytest benchmarks``.

``pytest benchmarks --quick`` takes each path once, short, with all assertions but those on speed.
"""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1]))  # last: an installed package comes first
pytest_plugins = ["tests.fixtures"]


def pytest_addoption(parser):
    parser.addoption("--quick", action="store_true", help="run each once, short, and time nothing")


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    """Run benchmarks one after another, in this process, though the project's options differ."""
    option = config.option
    option.numprocesses, option.dist, option.tx = None, "no", []
    option.benchmark_skip, option.benchmark_disable = False, option.quick


@pytest.fixture(scope="session")
def quick(request):
    """True where counts and sizes are cut and nothing is said of speed."""
    return request.config.getoption("quick")


@pytest.fixture
def row(record_property):
    """Return a writer of table rows: a table's title, and a cell for each column.

    The tables of all tests are printed at the end.
    """
    return lambda title, cells: record_property(
        "row", (title, {key: str(value) for key, value in cells.items()})
    )


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
