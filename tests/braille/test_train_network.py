"""The network that finds cells is learned from rendered pages: the same weights from a seed."""

import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest

from smarttouch.braille import cell_detection

from .embossed import network_bytes
from .embossed import train_network as program


@pytest.fixture(scope="module")
def page():
    """Return the crops of a rendered page, and what is wanted of them."""
    return program.crops_of((3, 6))


def small(crops, wanted):
    """Return the corners of two crops, of 48 pixels, as the network learns from them."""
    return crops[:2, 80:128, 80:128].copy(), wanted[:2, :, 20:32, 20:32].copy()


def test_a_page_is_the_same_from_a_seed(page):
    again, other = program.crops_of((3, 6)), program.crops_of((3, 7))
    assert all(np.array_equal(a, b) for a, b in zip(page, again, strict=True))
    assert not np.array_equal(page[0], other[0])
    assert page[0].shape == (4, 224, 224)
    assert page[1][:, 0].sum() > 20


def test_what_is_wanted_is_found_where_it_is_drawn(page):
    wanted = page[1][0].astype(np.float32)
    found = cell_detection.cells_of(wanted[:9])
    assert len(found.px) == wanted[0].sum()
    assert (found.patterns > 0).all()


def test_the_loss_falls_and_the_same_seed_gives_the_same_file(tmp_path, page):
    pytest.importorskip("torch")
    crops, wanted = small(*page)
    files = []
    for name, steps in (("a.onnx", 3), ("b.onnx", 3), ("first.onnx", 1)):
        program.save(program.train(crops, wanted, steps, 4, "cpu"), tmp_path / name)
        files.append((tmp_path / name).read_bytes())
    assert files[0] == files[1] != files[2]
    read = cv2.dnn.readNetFromONNX(str(tmp_path / "a.onnx"))
    read.setInput(np.zeros((1, 1, 48, 56), np.float32))
    assert read.forward().shape == (1, 9, 12, 14)


def test_weights_as_the_program_writes_them_are_those_that_ship():
    shipped = Path(cell_detection.__file__).with_name("network.onnx")
    rng, layers = np.random.default_rng(1), []
    widths = [1, *program.WIDTHS, *[program.WIDTHS[-1]] * len(program.DILATIONS), 9]
    for inside, outside in itertools.pairwise(widths):
        size = 1 if outside == 9 else 3
        weights = rng.normal(0, 0.1, (outside, inside, size, size)).astype(np.float32)
        layers.append((weights, np.zeros(outside, np.float32)))
    data = network_bytes(layers, len(program.WIDTHS), program.DILATIONS)
    assert len(data) == shipped.stat().st_size
    read = cv2.dnn.readNetFromONNX(np.frombuffer(data, np.uint8))
    read.setInput(np.ones((1, 1, 48, 56), np.float32))
    assert read.forward().shape == (1, 9, 12, 14)
