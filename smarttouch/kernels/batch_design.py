"""Batch design of kernels: every distinct site, on all cores, with results stored one by one."""

import contextlib
import json
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.base.files import read_bytes
from smarttouch.kernels.design_problem import Array, Kernel, KernelKind, Problem, limits_ma
from smarttouch.profile import Profile

Design = Callable[[Problem, int], Kernel]
Progress = Callable[[int, int], None]
Timed = tuple[Kernel, float]

_running: set[int] = set()  # threads of this process with a design in progress


def part_of(progress: Progress | None, index: int, parts: int) -> Progress:
    """Return the progress callback of one of several parts."""

    def advance(done: int, total: int) -> None:
        if progress is not None:
            progress(index * total + done, parts * total)

    return advance


def design_sites(
    problem: Problem,
    design: Design,
    sites: Sequence[int] | None = None,
    progress: Progress | None = None,
    keep: Path | None = None,
) -> list[Timed]:
    """Return the kernel and seconds of design of each site, with mirror images designed once.

    The work goes through `joblib.Parallel`: on threads here, as the solver releases the
    interpreter, or wherever ``joblib.parallel_config`` sends it (a Dask cluster, say). Kernels are
    stored in the folder `keep` one by one and read from there, so an interrupted design resumes.
    """
    from joblib import Parallel, delayed
    from threadpoolctl import threadpool_limits

    if sites is None:
        sites = problem.driven.tolist()
    for site in sites:
        problem.check_site(site)
    ways = [problem.representative(site) for site in sites]
    distinct = sorted({first for first, _ in ways})
    done = {first: kept for first in distinct if (kept := kept_kernel(keep, problem, first))}
    missing = [first for first in distinct if first not in done]
    answers = Parallel(n_jobs=-1, prefer="threads", return_as="generator_unordered")(
        delayed(_timed)(design, problem, first) for first in missing
    )
    # The cores are taken by sites: threads of the linear algebra would only wait for one another.
    with threadpool_limits(limits=1, user_api="blas"):
        try:
            for first, kernel, seconds in answers:
                done[first] = kernel, seconds
                if keep is not None:
                    keep_kernel(keep, problem, first, kernel, seconds)
                if progress is not None:
                    progress(len(done), len(distinct))
        except BaseException:
            answers.close()
            # A program that ends while a thread is inside the solver ends in an abort.
            while _running:
                time.sleep(0.02)
            raise
    return [
        (_moved(problem, site, done[first][0], move), done[first][1])
        for site, (first, move) in zip(sites, ways, strict=True)
    ]


def _timed(design: Design, problem: Problem, site: int) -> tuple[int, Kernel, float]:
    start = time.perf_counter()
    _running.add(threading.get_ident())
    try:
        kernel = design(problem, site)
    finally:
        _running.discard(threading.get_ident())
    return site, kernel, time.perf_counter() - start


def _moved(problem: Problem, site: int, kernel: Kernel, move: np.ndarray) -> Kernel:
    weights = np.empty_like(kernel.weights)
    weights[move] = kernel.weights
    # An axon that is mirrored counts its nodes the other way: the fired one shows which (Eq. 11).
    node = kernel.node and int((problem.axon(site) @ weights).argmax())
    return replace(kernel, weights=weights, node=node)


def _path(keep: Path, problem: Problem, site: int) -> Path:
    return keep / f"{problem.afferent.name}-{site}.json"


def keep_kernel(keep: Path, problem: Problem, site: int, kernel: Kernel, seconds: float) -> None:
    fields: dict[str, Any] = {
        "weights": kernel.weights.tolist(),
        "worst_other": kernel.off_target,
        "worst_other_class": kernel.off_target_class.name,
        "own_spill": kernel.spill,
        "node": kernel.node,
        "kind": kernel.kind,
        "gap": kernel.gap,
        "seconds": seconds,
    }
    # Another process may design the same, and remove the folder when it is done; what is not kept
    # is only designed again.
    with contextlib.suppress(OSError):
        keep.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=keep, suffix=".part", delete=False) as half:
            half.write(json.dumps(fields))
        Path(half.name).replace(_path(keep, problem, site))


def kept_kernel(keep: Path | None, problem: Problem, site: int) -> Timed | None:
    if keep is None:
        return None
    try:
        fields = json.loads(read_bytes(_path(keep, problem, site), DesignError))
        seconds = float(fields["seconds"])
        kernel = Kernel(
            weights=np.array(fields["weights"], np.float64), off_target=fields["worst_other"],
            off_target_class=Afferent[fields["worst_other_class"]], spill=fields["own_spill"],
            node=fields["node"], kind=fields["kind"], gap=fields["gap"],
        )  # fmt: skip
        whole = kernel.weights.shape == (problem.electrodes,) and bool(
            np.isfinite([*kernel.weights, kernel.off_target, kernel.spill, kernel.gap]).all()
        )
    except (DesignError, ValueError, KeyError, TypeError, AttributeError, OverflowError):
        return None
    return (kernel, seconds) if whole else None


_NOTHING = 1e-9  # part of a kernel's strongest current that is a last bit of the solver's
_CLEAR = 1 - 1e-6


def design_unless_known(
    design: Design, before: Profile, known_kernel: Callable[[Afferent, int, KernelKind], Kernel]
) -> Design:
    """Return a design that gives a site its kernel of another profile where that stays the best:
    without current at masked electrodes, and either its limits are the same, or the kernel
    is within the limits and was not held up by those before.

    An optimum stays optimal over any subset that contains it.
    """

    def keep_or_design(problem: Problem, site: int) -> Kernel:
        known = known_kernel(problem.afferent, site, "weighted")
        weights, masked = known.weights.copy(), list(problem.profile.output.masked)
        peak = np.abs(weights).max()
        if (np.abs(weights[masked]) > _NOTHING * peak).any() or not (
            _same_limits(before, problem.profile, site)
            or (_within(weights, site, before) and _within(weights, site, problem.profile))
        ):
            return design(problem, site)
        weights[masked] = 0.0
        weights[problem.driven] -= weights[problem.driven].mean()
        return replace(known, weights=weights)

    return keep_or_design


def _same_limits(before: Profile, now: Profile, site: int) -> bool:
    (total, own), (total_now, own_now) = limits_ma(before), limits_ma(now)
    alike = total == total_now and np.array_equal(own, own_now)
    return alike and bool(before.full_ma[site] == now.full_ma[site])


def _within(weights: Array, site: int, profile: Profile) -> bool:
    """Return whether a pattern (E,) keeps clear of a profile's limits at a site's full current."""
    total, electrode = limits_ma(profile)
    if weights[site] == 0:
        return bool(np.isinf(total) and np.isinf(electrode).all())
    carried = np.abs(weights) * float(profile.full_ma[site]) / abs(weights[site])
    in_all, carried[site] = carried.sum() / 2, 0.0
    return bool(in_all <= _CLEAR * total and (carried <= _CLEAR * electrode).all())
