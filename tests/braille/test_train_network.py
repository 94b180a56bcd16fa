"""The network that finds cells is learned from rendered pages: the same weights from a seed."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from smarttouch.braille import cell_detection

from .embossed import train_network as program


@pytest.fixture(scope="module")
def page():
    """Return the crops of a rendered page, and what is wanted of them."""
    return program.crops_of((3, 6))


def small(crops, wanted):
    """Return the corners of two crops, of 48 pixels, as the network learns from them."""
    batch = crops[:2, 80:128, 80:128].astype(np.float32)
    return batch, wanted[:2, :, 20:32, 20:32].astype(np.float32)


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


def test_the_loss_falls_as_its_gradient_says(page):
    network = program.Network(2)
    batch, wanted = small(*page)
    _, changes = network._changes(batch, wanted)
    step = 3e-4
    for k in (0, 2, 5, 10):
        weights = network.layers[k][0]
        at = np.unravel_index(np.abs(changes[k][0]).argmax(), weights.shape)
        weights[at] += step
        higher = network._changes(batch, wanted)[0]
        weights[at] -= 2 * step
        lower = network._changes(batch, wanted)[0]
        assert (higher - lower) / (2 * step) == pytest.approx(changes[k][0][at], rel=0.05)
    losses = [network.learn(batch, wanted, 1e-3) for _ in range(12)]
    assert losses[-1] < 0.7 * losses[0]


def test_a_short_training_gives_the_same_file_twice_and_it_is_read(tmp_path, page):
    files = []
    for name in ("a.onnx", "b.onnx"):
        network = program.Network(4)
        for _ in range(2):
            network.learn(*small(*page), 1e-3)
        network.save(tmp_path / name)
        files.append(np.fromfile(tmp_path / name, np.uint8))
    assert np.array_equal(*files)
    read = cv2.dnn.readNetFromONNX(files[0])
    read.setInput(np.zeros((1, 1, 48, 56), np.float32))
    assert read.forward().shape == (1, 9, 12, 14)
    shipped = Path(cell_detection.__file__).with_name("network.onnx")
    assert len(files[0]) == shipped.stat().st_size
