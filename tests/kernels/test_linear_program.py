"""The min–max programme: against scipy, without a bottom, and with a solver that goes astray."""

import numpy as np
import pytest

from smarttouch.kernels import linear_program
from smarttouch.kernels.linear_program import LinearProgram, ProgramRows


def dense(rows):
    return ProgramRows([(rows, 1.0, None)], np.eye(rows.shape[1]))


def random_programme(seed, rows=120, unknowns=6):
    rng = np.random.default_rng(seed)
    coefficients, aim = rng.normal(size=(rows, unknowns)), rng.normal(size=(1, unknowns))
    size = np.ones(unknowns)
    return (
        coefficients,
        aim,
        LinearProgram(dense(coefficients), np.ones(rows), np.zeros(rows), aim, size, (size,)),
    )


def test_what_cannot_be_reached_is_infinite():
    even = np.ones((1, 4))
    unreachable = LinearProgram(
        dense(np.eye(4)), np.ones(4), np.zeros(4), even, np.ones(4), (np.ones(4),)
    )  # fmt: skip
    assert unreachable.most_selective() == np.inf


def test_only_the_optimum_is_proven():
    _, _, mine = random_programme(1)
    mine.most_selective()
    answer = np.asarray(mine._solver.getSolution().col_value)
    assert mine._proven(answer)
    assert not mine._proven(answer + 1e-3)


def test_an_answer_that_is_not_proven_is_computed_again(monkeypatch):
    _, _, usual = random_programme(2)
    expected, asked = usual.most_selective(), []
    monkeypatch.setattr(LinearProgram, "_proven", lambda *_: bool(asked.append(1)))
    _, _, doubted = random_programme(2)
    assert doubted.most_selective() == pytest.approx(expected, abs=1e-9)
    assert asked == [1], "the cold answer is believed"


def test_a_simplex_that_runs_in_circles_gives_way(monkeypatch):
    _, _, usual = random_programme(3)
    expected = usual.most_selective()
    monkeypatch.setattr(linear_program, "_PATIENCE", 0)
    _, _, stuck = random_programme(3)
    assert stuck.most_selective() == pytest.approx(expected, abs=1e-6)
