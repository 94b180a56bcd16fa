"""``smarttouch experiment fit``, as a user sees it."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from smarttouch.base.errors import ExperimentError, SmartTouchError
from smarttouch.cli.experiment import fit
from smarttouch.experiments.psychophysics.procedures import constant_stimuli, ratio_pairs

from ..experiments.psychophysics.simulated import Subject, answer_all
from .conftest import says


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Return a runner of the command in an empty folder: its output, or the error's sentence."""
    monkeypatch.chdir(tmp_path)
    app = typer.Typer()
    app.command()(fit)

    def run(*arguments):
        found = CliRunner().invoke(app, [*map(str, arguments)])
        if found.exception is not None and not isinstance(found.exception, SystemExit):
            raise found.exception
        return found.output

    return run


def session(path, thresholds, seed=0):
    """Write the answers of a subject with these thresholds of standards; none: the first."""
    with path.open("w", newline="", encoding="utf-8-sig") as file:
        writer = csv.writer(file)
        writer.writerow(["standard", "comparison", "comparison_interval", "unit", "success"])
        for standard, threshold in thresholds.items():
            procedure = constant_stimuli(ratio_pairs([standard]), 20, seed=seed)
            subject = Subject(threshold or 1.0, 0.2)
            answers = answer_all(procedure, subject.probability, seed + int(standard))
            success = answers.success if threshold else answers.interval == 1
            for row in zip(answers.comparison, answers.interval, success, strict=True):
                writer.writerow([standard, row[0], row[1], "Hz", int(row[2])])


def test_two_modes(program, tmp_path):
    session(tmp_path / "RA.csv", {30.0: 36.0, 75.0: None})
    session(tmp_path / "PC.csv", {30.0: 36.0, 75.0: 90.0})
    said = program("RA.csv", "PC.csv", "--plot", "a.png", "--json", "a.json")
    lines = said.splitlines()
    assert lines[0] == "RA, Hz"
    assert lines[1].split() == [
        "standard", "n", "75%", "at", "Weber", "lower", "middle", "spread", "lapse", "p",
    ]  # fmt: skip
    (without,) = (line for line in lines if line.startswith("75: "))
    assert "200 of 200" in without
    assert max(map(len, lines[:3])) <= 80
    assert (tmp_path / "a.png").stat().st_size > 10_000
    figures = json.loads((tmp_path / "a.json").read_text())
    assert list(figures) == ["RA", "PC"]
    good, bad = figures["RA"]
    assert good["threshold"]["low"] < good["threshold"]["value"] < good["threshold"]["high"]
    assert good["threshold"]["value"] == pytest.approx(36, rel=0.1)
    assert good["weber"]["value"] == pytest.approx(good["threshold"]["value"] / 30 - 1)
    assert good["verdict"] is None
    assert bad["threshold"] is bad["weber"] is bad["spread"] is None
    assert bad["verdict"]
    row = lines[2].split()
    assert row[:2] == ["30", "200"]
    assert float(row[2]) == pytest.approx(good["threshold"]["value"], rel=0.01)


def test_others_answers(program, tmp_path):
    """Detection of somebody else's: no standard, columns with names of their own."""
    random = np.random.default_rng(2)
    subject = Subject(0.8, 0.3, 0.5, 0.01, guess=0.1)
    felt = [
        f"{level};{'yes' if random.random() < subject.probability(level) else 'no'}"
        for level in (0.0, 0.3, 0.5, 0.7, 0.9, 1.2, 1.6)
        for _ in range(25)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["mA;ok", *felt]))

    def fitted(options):
        program(*f"a.csv --x mA --y ok --json a.json {options}".split())
        (found,) = json.loads((tmp_path / "a.json").read_text())["a"]
        return found

    found = fitted("--plot a.svg")
    assert found["standard"] is found["weber"] is None
    assert found["at"] == 0.5
    assert 0 < found["guess"] < 0.3
    assert found["threshold"]["value"] == pytest.approx(0.8, rel=0.2)
    for options, at in (
        ("--guess 0.1 --function weibull", 0.55),
        ("--guess equal --function logistic --at 0.6", 0.6),
        ("--guess free", 0.5),
    ):
        found = fitted(options)
        assert found["at"] == pytest.approx(at)
        assert found["threshold"]["value"] == pytest.approx(0.8, rel=0.3)


@pytest.mark.parametrize(("options", "wrong"), [
    ("none.csv", says(ExperimentError, value=Path("none.csv"))),
    ("a.csv --x hz",
     says(ExperimentError, "a.csv", "comparison or success", value="hz")),
    ("a.csv --guess half", says(ExperimentError, value="half")),
    ("a.csv --function cubic",
     says(value="cubic", allowed=("normal", "logistic", "weibull"))),
    ("a.csv --plot a.doc", says(SmartTouchError, "a.doc", "*.png")),
    ("a.csv --plot none/a.png", says(value=Path("none/a.png"))),
])  # fmt: skip
def test_what_a_user_can_do_wrong(program, tmp_path, options, wrong):
    (tmp_path / "a.csv").write_text("comparison,success\n1,0\n2,1\n")
    with pytest.raises(SmartTouchError) as caught:
        program(*options.split())
    wrong(caught.value)


def test_files_of_the_same_name(program, tmp_path):
    for folder in ("p1", "p2"):
        (tmp_path / folder).mkdir()
        session(tmp_path / folder / "RA.csv", {30.0: 36.0})
    said = program("p1/RA.csv", "p2/RA.csv", "--json", "a.json")
    assert list(json.loads((tmp_path / "a.json").read_text())) == ["p1/RA.csv", "p2/RA.csv"]
    assert [line for line in said.splitlines() if "RA.csv" in line] == [
        "p1/RA.csv, Hz",
        "p2/RA.csv, Hz",
    ]
