"""Benchmarks: ``pytest benchmarks`` prints their results as Markdown tables at the end.

``pytest benchmarks --quick`` runs each code path once and briefly, without assertions on speed.
"""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1]))  # last, so that an installed package is preferred
pytest_plugins = ["tests.fixtures"]


def pytest_addoption(parser):
    parser.addoption("--quick", action="store_true", help="run each benchmark briefly, untimed")


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    """Run benchmarks one after another in this process; pyproject.toml requests parallel tests."""
    option = config.option
    option.numprocesses, option.dist, option.tx = None, "no", []
    option.benchmark_skip, option.benchmark_disable = False, option.quick


@pytest.fixture(scope="session")
def quick(request):
    """Return whether to reduce counts and sizes, and to skip assertions on speed."""
    return request.config.getoption("quick")


@pytest.fixture
def row(record_property):
    """Return a function that adds a row to a table, given the table's title and cells by column.

    Rows with the same title form one table. All tables are printed at the end of the run.
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
