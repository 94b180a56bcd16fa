"""``smarttouch study``: fingers, kernels, scans and patterns compared in a table and a plot."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.cli.options import ClusterOption, QuietOption


def study(
    plan: Annotated[
        Path, typer.Argument(metavar="STUDY.toml", help="What is compared, on which fingers.")
    ],
    output: Annotated[
        Path, typer.Option(metavar="DIR", help="Where to; made if missing, resumed if not.")
    ],
    cluster: ClusterOption = None,
    kind: Annotated[
        str | None, typer.Option("--plot", metavar="png|pdf|svg|none", help="Of the plot.")
    ] = None,
    quiet: QuietOption = False,
) -> None:
    """Run a grid of fingers, profiles, kernels, scans, letters and pages; go on where it ended."""
    from importlib.util import find_spec

    from smarttouch.cluster import on_cluster
    from smarttouch.errors import not_offered
    from smarttouch.monitor.progress import bank_progress, lines_progress
    from smarttouch.plotting import style
    from smarttouch.studies.plan import load_study
    from smarttouch.studies.run import ROWS_FILE, run_study
    from smarttouch.studies.summary import NAMES, summed, table_rows
    from smarttouch.terminal import print_table

    asked = load_study(plan)
    offered = (*style.FORMATS, "none")
    if kind is None:
        kind = "png" if find_spec("matplotlib") else "none"
    if kind not in offered:
        raise not_offered("plot", kind, offered)
    if kind != "none":
        style.new_figure(1, 1)
    with (
        on_cluster(cluster),
        bank_progress(quiet) as designing,
        lines_progress(quiet, "Fingers") as progress,
    ):
        rows = run_study(asked, plan.parent, output, designing, progress)
    found = summed(rows)
    if not quiet:
        heading, lines = table_rows(found)
        print_table(
            lines,
            heading,
            title=asked.title,
            note="Medians over fingers of means over patterns: read wrongly, silent points, spikes "
            "of another class, misplaced ones. Best on: fingers on which no other choice is read "
            "with fewer errors. mA: mean total current of a slot.",
            ruled=True,
            left=2,
        )
        print(output / ROWS_FILE)
    if kind != "none":
        from smarttouch.plotting.studies import study_figure

        picture = output / f"study.{kind}"
        style.save(study_figure(found, NAMES, asked.title), picture)
        if not quiet:
            print(picture)
