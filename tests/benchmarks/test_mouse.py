"""The electric mouse: frequencies, and objects that stay put.

Run with::

    pytest tests/benchmarks/test_mouse.py --benchmark-only -n0

Measured on what a simulated board delivered: pulses of each electrode, where it was.
"""

import itertools
import math

import cv2
import numpy as np
import pytest

from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.instruments.relief import open_texture
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile

from ..instruments.touched import grating_file, object_file, path_motion, stroke, touch

PROFILE = profile_for_reading(load_profile("electric-mouse"))
STROKE_MM = 60.0


@pytest.fixture(scope="module")
def bank():
    return load_bank(PROFILE)


def error_of(texture, speed, want_hz, bank, **options):
    pulses_hz, sensor = stroke(texture, speed, PROFILE, bank, STROKE_MM, **options)
    mean, worst = pulses_hz.mean() - want_hz, np.abs(pulses_hz - want_hz).max()
    one = speed / STROKE_MM
    assert abs(mean) < want_hz / 2
    return {
        "expected, Hz": f"{want_hz:.2f}", "mean": f"{mean:+.3f}", "worst electrode": f"{worst:.2f}",
        "one pulse": f"{one:.2f}", "told": "; ".join(sensor.notes),
    }  # fmt: skip


def test_frequencies(row, quick, bank, tmp_path):
    def show(texture, cells):
        row("Pulses of each electrode on gratings", {"texture": texture} | cells)

    def some(found):
        return found[:1] if quick else found

    for angle in some((0, 30, 60, 90)):
        for speed in (80,) if quick else (20, 40, 80):
            want = speed / 4 * abs(math.cos(math.radians(angle)))
            texture = open_texture(f"grating:4mm,{angle}deg")
            show(f"4 mm, {angle}°, {speed} mm/s", error_of(texture, speed, want, bank))
    images = [
        (4, 30, "faint"), (1, 0, "square"), (2, 30, "thin"), (4, 0, "square"), (4, 0, "thin"),
        (4, 60, "square"), (8, 30, "faint"),
    ]  # fmt: skip
    for pitch, angle, kind in some(images):
        noise = 5.0 if kind == "faint" else 0.0
        path = grating_file(tmp_path / "g.png", pitch, angle, kind, noise=noise)
        texture = open_texture(str(path), grain_mm=20.0)
        speed = 15 * pitch
        want = speed / pitch * math.cos(math.radians(angle))
        show(f"image {pitch} mm, {angle}°, {kind}", error_of(texture, speed, want, bank))
    fast = [(100, 120), (100, 160), (100, 200), (100, 300), (200, 300), (200, 400)]
    for rate, speed in some(fast):
        texture = open_texture("grating:4mm,10deg")
        want = speed / 4 * math.cos(math.radians(10))
        cells = error_of(texture, speed, want, bank, rate_hz=rate)
        show(f"4 mm, 10°, {speed} mm/s, {rate} frames/s", cells)


def ways(folder):
    """Return motions over an object in the middle of 80 x 40 mm."""
    time_s = np.linspace(0, 2, 201)
    yield "straight, 40 mm/s", path_motion(folder, time_s, 40 * time_s, 20 + 0 * time_s)
    yield "straight, 80 mm/s", path_motion(folder, time_s / 2, 40 * time_s, 20 + 0 * time_s)
    bent = 20 + 6 * np.sin(math.pi * time_s)
    yield "bent, 40 mm/s to the right", path_motion(folder, time_s, 40 * time_s, bent)
    yield "bent, 40 mm/s to the left", path_motion(folder, time_s, 80 - 40 * time_s, bent)
    turn = 2 * math.pi * time_s / 2
    yield "circle", path_motion(folder, time_s, 40 + 12 * np.sin(turn), 20 + 12 * np.cos(turn))
    swing = np.linspace(0, 6, 601)
    there = 40 + 14 * np.sin(2 * math.pi * swing / 1.5)
    yield "to and fro", path_motion(folder, swing, there, 20 + swing - 3)


def residual_of(drawing, texture):
    """Return by how much pulses are off the object, mm: centroid, and best shift of the picture."""
    wide, high = texture.size_mm
    shape = (round(high / 0.1), round(wide / 0.1))
    drawn = 255 - texture.draw(0.0, 0.0, shape, 0.1).astype(np.float32)
    got = 255 - drawing.picture((0.0, 0.0), shape, 0.1).astype(np.float32)
    y, x = np.mgrid[: shape[0], : shape[1]] * 0.1 + 0.05
    middle = [
        float((each * got).sum() / got.sum() - (each * drawn).sum() / drawn.sum())
        for each in (x, y)
    ]
    margin = 40
    score = cv2.matchTemplate(
        cv2.copyMakeBorder(got, *(margin,) * 4, cv2.BORDER_CONSTANT), drawn, cv2.TM_CCORR
    )
    _, best, _, (column, row) = cv2.minMaxLoc(score)
    return middle, ((column - margin) / 10, (row - margin) / 10), best


def test_objects_stay_put(row, quick, bank, tmp_path):
    for kind in ("disc", "cross"):
        texture = open_texture(str(object_file(tmp_path / "o.png", kind)))
        for name, motion in itertools.islice(ways(tmp_path), 1 if quick else None):
            touched, _ = touch(texture, motion, PROFILE, bank)
            middle, shift, _ = residual_of(touched.drawing, texture)
            assert max(map(abs, middle)) < 1
            row(
                "Objects stay where they are",
                {
                    "object": kind,
                    "way": name,
                    "centroid off by, mm": f"{middle[0]:+.2f}, {middle[1]:+.2f}",
                    "best shift, mm": f"{shift[0]:+.1f}, {shift[1]:+.1f}",
                    "pulses": len(touched.felt.number),
                },
            )
