"""Measurement of the frame rate, age and values of a source for ``smarttouch devices show``."""

import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from smarttouch.sources.force import ForceSource
from smarttouch.sources.source_contract import Source

READ_HZ = 100.0  # number of reads per second


def sample_source(source: Source, seconds: float) -> list[tuple[str, str]]:
    """Read a source, which must be open, for some seconds or until its end. Return pairs of name
    and value."""
    frames = []
    for time_ns in _ticks(seconds):
        frame = source.read(time_ns)
        if frame is None:
            break
        frames.append(frame)
    # The first read is at 0 s, so the last of n reads is n - 1 periods later.
    lasted_s = frames[-1].time_ns / 1e9 + 1 / READ_HZ if frames else seconds
    rows = [
        ("source", source.title),
        ("frames", f"{source.frames}, {source.frames / lasted_s:.1f} a second"),
        ("read", f"{source.frames - source.dropped_frames} frames, polled at {READ_HZ:g} Hz"),
        ("dropped", f"{source.dropped_frames}, never read"),
    ]
    if frames:
        image, pose = frames[-1].image, frames[-1].pose
        if image is not None:
            height, width = image.shape
            grey = f"grey {image.min()} to {image.max()}, mean {image.mean():.0f}"
            rows.append(("size", f"{width} x {height}, {grey}"))
        age_ms = np.array([frame.age_ns / 1e6 for frame in frames])
        moved = f"x {pose.x_mm:.2f} mm, y {pose.y_mm:.2f} mm"
        rows += [
            ("age", f"{np.median(age_ms):.1f} ms, at most {age_ms.max():.1f}"),
            ("position", moved + (", stale" if frames[-1].stale else "")),
        ]
    return [*rows, ("force", _range(np.array([frame.force_n for frame in frames])))]


def sample_force(source: ForceSource, seconds: float) -> list[tuple[str, str]]:
    """Read a force source, which must be open, for some seconds. Return pairs of name and value."""
    force_n = np.array([source.read(time_ns) for time_ns in _ticks(seconds)])
    unknown = int(np.isnan(force_n).sum())
    return [
        ("source", source.title),
        ("force", _range(force_n)),
        ("unknown", f"force not known in {unknown} of {len(force_n)} reads"),
    ]


def _ticks(seconds: float) -> Iterator[int]:
    """Wait until each read is due, then yield its time since the first read, ns."""
    yield 0
    start_ns = time.perf_counter_ns()
    for count in range(1, round(seconds * READ_HZ) + 1):
        due_ns = round(count * 1e9 / READ_HZ)
        time.sleep(max(0, start_ns + due_ns - time.perf_counter_ns()) / 1e9)
        yield due_ns


def _range(forces_n: NDArray[np.float64]) -> str:
    known = forces_n[np.isfinite(forces_n)]
    if not known.size:
        return "not known"
    return f"{known.min():.3f} to {known.max():.3f} N, mean {known.mean():.3f}"
