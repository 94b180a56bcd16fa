"""Train the network that finds cells of Braille on rendered pages, from a seed.

    python examples/read_braille/train_network.py network.onnx --gpu

writes a network that ``smarttouch/braille/network.onnx`` can be replaced by, the same to the bit on
the same kind of machine: with CuPy on a graphics card in six minutes, with numpy, without
``--gpu``, in a day or more. ``--pages 8 --steps 4`` shows the way. No photograph goes into it.
"""

import argparse
import itertools
import multiprocessing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from embossed_pages import emboss, printed, random_lines
from numpy.typing import NDArray
from onnx_file import network_bytes

from smarttouch.braille.cell_detection import STRIDE, evened

SEED, PAGES, STEPS = 1, 7_500, 7_000
SIDE_PX, OF_A_PAGE, AT_ONCE = 224, 4, 64
"""Side of a crop, crops of a page, and crops of a step."""
WIDTHS, DILATIONS = (12, 24, 40), (1, 1, 2, 4, 8, 2, 1)
"""Channels of the first layers, which halve the picture twice, the last those of all others; and
how far apart these look."""
RATE, WARM = 2e-3, 400  # highest rate of learning, and the steps until then
_DECAY = 0.9, 0.99  # of Adam's means
_OFFSET, _DOT = 0.5, 0.25  # weights of offsets and dots beside that of a cell's being there
_EDGE_PX = 9.0  # cells whose middles are so near the edge of a crop count neither way
_MAPS = 11
"""Of what is wanted: cell, two offsets, six dots, weight of the first, and where a cell is near."""

Image = NDArray[np.float32]


def crops_of(seed: tuple[int, int]) -> tuple[NDArray[np.float16], NDArray[np.float16]]:
    """Return crops of a random page, (4, 224, 224), and what is wanted of each, (4, 11, 56, 56)."""
    rng = np.random.default_rng(seed)
    grey, cells_px, patterns = _page(rng)
    grey = _photographed(grey, rng)
    crops, wanted = [], []
    for _ in range(OF_A_PAGE):
        top, left = (int(rng.integers(0, side - SIDE_PX + 1)) for side in grey.shape)
        crop = np.ascontiguousarray(grey[top : top + SIDE_PX, left : left + SIDE_PX])
        crops.append(evened(crop).astype(np.float16))
        wanted.append(_wanted(cells_px - (left, top), patterns))
    return np.stack(crops), np.stack(wanted)


def _page(rng: Any) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.int_]]:
    """Return a picture of random cells, at a scale at which they are found, and its cells."""
    pitch_px, finer = float(rng.uniform(18, 33)), float(rng.uniform(1.0, 2.2))
    cell_mm = float(rng.uniform(5.7, 6.8))
    rows, columns = int(rng.integers(7, 12)), int(rng.integers(9, 18))
    dense, blank = float(rng.uniform(0.3, 0.6)), float(rng.choice([0.05, 0.15, 0.4]))
    lines, back = (
        random_lines(rows, columns, int(rng.integers(1 << 30)), blank, dense) for _ in range(2)
    )
    ink = rng.random() < 0.08
    made = emboss(
        lines,
        px_per_mm=finer * pitch_px / cell_mm,
        light_deg=float(rng.uniform(8, 172)),
        skew_deg=float(rng.uniform(-9, 9) if rng.random() < 0.5 else rng.uniform(-2, 2)),
        blur_px=float(rng.choice([0.5, 1.0, 2.0, 3.0])) * finer / 1.5,
        noise=float(rng.choice([2.0, 6.0, 14.0])),
        shading=float(rng.uniform(0, 0.6)),
        texture=float(rng.choice([1.0, 2.0, 3.0, 5.0])),
        perspective=float(rng.uniform(0, 0.15)),
        curl_mm=float(rng.choice([0.0, 3.0, 6.0, 10.0])),
        back_side=back if rng.random() < 0.6 and not ink else None,
        dent=float(rng.uniform(0.5, 1.15)),
        dot_mm=float(rng.uniform(0.33, 0.44)) * cell_mm,
        cell_mm=cell_mm,
        line_mm=float(rng.uniform(1.45, 1.9)) * cell_mm,
        uneven=float(rng.uniform(0.06, 0.28)),
        lost=float(rng.choice([0.0, 0.02, 0.06])),
        quality=int(rng.integers(30, 96)),
        height_mm=float(rng.uniform(0.14, 0.55)),
        radius_mm=float(rng.uniform(0.55, 0.9)),
        elevation_deg=float(rng.uniform(14, 60)),
        ambient=float(rng.uniform(0.25, 0.75)),
        seed=int(rng.integers(1 << 30)),
    )
    page = made.page
    if ink:
        page = printed(made, float(rng.uniform(0.3, 0.6)) * finer * pitch_px * 0.38,
                       bool(rng.random() < 0.3))  # fmt: skip
    scale = 1 / finer
    height, width = (max(SIDE_PX, round(side * scale)) for side in page.grey.shape)
    grey = cv2.resize(page.grey, (width, height), interpolation=cv2.INTER_AREA)
    ratio = np.array([width, height]) / page.grey.shape[::-1]
    cells_px = (made.cells_px + 0.5) * ratio - 0.5
    if rng.random() < 0.4:
        grey = _beside(np.asarray(grey, np.uint8), cells_px, pitch_px, rng)
    if rng.random() < 0.06:
        return _other(np.asarray(grey, np.uint8), rng), np.zeros((0, 2)), np.zeros(0, int)
    return np.asarray(grey, np.uint8), cells_px, made.patterns


def _beside(
    grey: NDArray[np.uint8], cells_px: NDArray[np.float64], pitch_px: float, rng: Any
) -> NDArray[np.uint8]:
    """Return a page with print, rules or holes where no cell is."""
    ink = np.zeros(grey.shape, np.uint8)
    for _ in range(int(rng.integers(1, 8))):
        x, y = (int(rng.integers(0, side)) for side in grey.shape[::-1])
        kind, wide = rng.integers(3), int(rng.integers(1, 4))
        if kind == 0:
            words = "".join(rng.choice(list("abcdefghij klmnopq.:;")) for _ in range(12))
            cv2.putText(ink, words, (x, y), int(rng.integers(0, 7)), float(rng.uniform(0.3, 1.0)),
                        255, wide, cv2.LINE_AA)  # fmt: skip
        elif kind == 1:
            end = (x + int(rng.integers(-200, 200)), y + int(rng.integers(-20, 20)))
            cv2.line(ink, (x, y), end, 255, wide, cv2.LINE_AA)
        else:
            cv2.circle(ink, (x, y), int(rng.integers(2, 14)), 255, -1, cv2.LINE_AA)
    for x, y in np.rint(cells_px).astype(int).tolist():
        half, down = round(pitch_px / 2), round(0.7 * pitch_px)
        ink[max(0, y - down) : y + down, max(0, x - half) : x + half] = 0
    dark = float(rng.uniform(0.2, 0.9))
    return np.asarray(grey * (1 - dark * ink.astype(np.float32) / 255), np.uint8)


def _other(grey: NDArray[np.uint8], rng: Any) -> NDArray[np.uint8]:
    """Return a picture of anything but Braille."""
    kind = rng.integers(3)
    if kind == 0:
        coarse = rng.standard_normal(tuple(side // 3 + 1 for side in grey.shape)).astype(np.float32)
        soft = cv2.resize(cv2.GaussianBlur(coarse, (0, 0), float(rng.uniform(0.4, 3))),
                          grey.shape[::-1])  # fmt: skip
        return np.asarray(np.clip(150 + 40 * soft / soft.std(), 0, 255), np.uint8)
    page = np.full(grey.shape, 225, np.uint8)
    if kind == 1:
        for y in range(20, grey.shape[0], int(rng.integers(14, 40))):
            signs = list("abcdefghijklmnopqrstuvwxyz    .:;i")
            words = "".join(rng.choice(signs) for _ in range(60))
            cv2.putText(page, words, (10, y), int(rng.integers(0, 7)), float(rng.uniform(0.3, 0.9)),
                        40, int(rng.integers(1, 3)), cv2.LINE_AA)  # fmt: skip
        return page
    step = float(rng.uniform(8, 30))
    for x, y in np.argwhere(np.ones([int(side / step) + 1 for side in page.shape[::-1]])) * step:
        cv2.circle(page, (int(x), int(y)), int(rng.integers(2, 5)), 70, -1, cv2.LINE_AA)
    return page


def _photographed(grey: NDArray[np.uint8], rng: Any) -> NDArray[np.uint8]:
    """Return a picture with the contrast, noise and JPEG of a camera."""
    picture = 255 * (grey / 255.0) ** float(rng.uniform(0.6, 1.6))
    picture = picture * float(rng.uniform(0.3, 1.0)) + float(rng.uniform(0, 40))
    picture += float(rng.choice([0.0, 2.0, 6.0])) * rng.standard_normal(grey.shape)
    picture = np.clip(picture, 0, 255).astype(np.uint8)
    quality = int(rng.integers(25, 95))
    _, packed = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), np.uint8)


def _wanted(cells_px: NDArray[np.float64], patterns: NDArray[np.int_]) -> NDArray[np.float16]:
    """Return the maps wanted of a crop, (11, 56, 56)."""
    side = SIDE_PX // STRIDE
    maps = np.zeros((_MAPS, side, side), np.float16)
    maps[9] = 1
    near = ((cells_px > -_EDGE_PX) & (cells_px < SIDE_PX + _EDGE_PX)).all(axis=1)
    for (x, y), cells in zip(cells_px[near], patterns[near].tolist(), strict=True):
        place = (np.array([x, y]) - (STRIDE - 1) / 2) / STRIDE
        column, row = np.rint(place).astype(int).tolist()
        inside = bool((np.minimum((x, y), SIDE_PX - 1 - np.array((x, y))) >= _EDGE_PX).all())
        for down in range(max(0, row - 1), min(side, row + 2)):
            for right in range(max(0, column - 1), min(side, column + 2)):
                maps[9, down, right] = 0
                if inside:
                    maps[1:3, down, right] = place[0] - right, place[1] - down
                    maps[3:9, down, right] = cells >> np.arange(6) & 1
                    maps[10, down, right] = 1
        if inside:
            maps[(0, 9), row, column] = 1
    return maps


class Network:
    """Weights and biases of each layer, and how they are learned; ``xp`` is numpy or CuPy."""

    def __init__(self, seed: int, xp: Any = np) -> None:
        rng = np.random.default_rng(seed)
        widths = [1, *WIDTHS, *[WIDTHS[-1]] * len(DILATIONS), 9]
        self.xp = xp
        self.layers: list[list[Any]] = []
        for k, (inside, outside) in enumerate(itertools.pairwise(widths)):
            size = 1 if k == len(widths) - 2 else 3
            spread = np.sqrt((1 if size == 1 else 2) / (inside * size * size))
            # Each layer that is added to what came before begins small.
            spread *= 0.3 if 3 <= k < len(widths) - 2 else 1
            weights = rng.normal(0, spread, (outside, inside, size, size))
            bias = np.zeros(outside)
            if size == 1:
                bias[0] = -4.0  # cells are rare
            self.layers.append([xp.asarray(each, xp.float32) for each in (weights, bias)])
        self._means = [[0.0, 0.0] for _ in self.layers]
        self._squares = [[0.0, 0.0] for _ in self.layers]
        self._step = 0

    def learn(self, crops: Any, wanted: Any, rate: float) -> float:
        """Change the weights by one step of Adam; return the loss."""
        loss, changes = self._changes(crops, wanted)
        self._step += 1
        slow, slower = _DECAY
        for k, layer in enumerate(self.layers):
            for part, change in enumerate(changes[k]):
                mean = self._means[k][part] = slow * self._means[k][part] + (1 - slow) * change
                square = slower * self._squares[k][part] + (1 - slower) * change * change
                self._squares[k][part] = square
                step = mean / (1 - slow**self._step)
                step /= self.xp.sqrt(square / (1 - slower**self._step)) + 1e-8
                layer[part] -= self.xp.float32(rate) * step
        return loss

    def _changes(self, crops: Any, wanted: Any) -> tuple[float, list[tuple[Any, Any]]]:
        """Return the loss of a batch, (B, H, W), and its gradient by the weights."""
        xp = self.xp
        strides = (1, 2, 2, *[1] * (len(DILATIONS) + 1))
        dilations = (1, 1, 1, *DILATIONS, 1)
        image = crops[:, None]
        kept = []
        for k, (weights, bias) in enumerate(self.layers):
            taps, shape = _taps(xp, image, weights.shape[-1], strides[k], dilations[k])
            flat = weights.transpose(0, 2, 3, 1).reshape(len(weights), -1)
            made = (xp.matmul(flat, taps) + bias[:, None]).reshape(len(image), -1, *shape)
            kept.append((taps, flat, image.shape, made > 0))
            last = k == len(self.layers) - 1
            fired = made if last else xp.maximum(made, 0)
            image = image + fired if k >= 3 and not last else fired
        loss, back = _loss(xp, image, wanted)
        changes: list[tuple[Any, Any]] = []
        for k in reversed(range(len(self.layers))):
            taps, flat, before, positive = kept.pop()
            last = k == len(self.layers) - 1
            through = back if last else back * positive
            rows = through.reshape(len(through), through.shape[1], -1)
            turned = xp.matmul(rows, taps.transpose(0, 2, 1)).sum(axis=0)
            weights = self.layers[k][0]
            _, inside, size, _ = weights.shape
            shaped = turned.reshape(len(weights), size, size, inside).transpose(0, 3, 1, 2)
            changes.append((shaped, rows.sum(axis=(0, 2))))
            if k:
                spread = xp.matmul(flat.T, rows)
                inner = _untapped(xp, spread, before, size, strides[k], dilations[k])
                back = back + inner if k >= 3 and not last else inner
        return loss, changes[::-1]

    def save(self, path: Path) -> None:
        """Write the network as the package ships it, its weights as half numbers."""
        plain = np.asarray if self.xp is np else self.xp.asnumpy
        layers = [(plain(weights), plain(bias)) for weights, bias in self.layers]
        path.write_bytes(network_bytes(layers, len(WIDTHS), DILATIONS))


def _taps(xp: Any, image: Any, size: int, stride: int, dilation: int) -> tuple[Any, Any]:
    """Return what each weight of a layer is multiplied by, (B, size * size * C, N), and the shape
    of its output."""
    edge = dilation * (size // 2)
    framed = xp.pad(image, ((0, 0), (0, 0), (edge, edge), (edge, edge)))
    batch, channels = image.shape[:2]
    height, width = (-(-side // stride) for side in image.shape[2:])
    taps = xp.empty((batch, size, size, channels, height, width), xp.float32)
    for row, column in np.ndindex(size, size):
        seen = framed[:, :, row * dilation :: stride, column * dilation :: stride]
        taps[:, row, column] = seen[:, :, :height, :width]
    return taps.reshape(batch, -1, height * width), (height, width)


def _untapped(
    xp: Any, spread: Any, shape: tuple[int, ...], size: int, stride: int, dilation: int
) -> Any:
    """Return the gradient by a layer's input from that by its taps."""
    edge = dilation * (size // 2)
    batch, channels, rows, columns = shape
    height, width = -(-rows // stride), -(-columns // stride)
    parts = spread.reshape(batch, size, size, channels, height, width)
    framed = xp.zeros((batch, channels, rows + 2 * edge, columns + 2 * edge), xp.float32)
    for row, column in np.ndindex(size, size):
        top, left = row * dilation, column * dilation
        framed[
            :, :, top : top + stride * height : stride, left : left + stride * width : stride
        ] += parts[:, row, column]
    return framed[:, :, edge : edge + rows, edge : edge + columns]


def _loss(xp: Any, made: Any, wanted: Any) -> tuple[float, Any]:
    """Return the loss of maps, (B, 9, H, W), and its gradient by them."""
    there, near = wanted[:, 9:10], wanted[:, 10:11]
    count = xp.maximum(wanted[:, :1].sum(), 1)
    share = 1 / (1 + xp.exp(-xp.clip(made, -30, 30)))
    signs = xp.concatenate([there, near.repeat(2, axis=1) * _OFFSET, near.repeat(6, axis=1) * _DOT],
                           axis=1)  # fmt: skip
    away = made - wanted[:, :9]
    back = signs * xp.concatenate(
        [share[:, :1] - wanted[:, :1], xp.clip(away[:, 1:3], -1, 1), share[:, 3:] - wanted[:, 3:9]],
        axis=1,
    )
    right = wanted[:, :9] * share + (1 - wanted[:, :9]) * (1 - share)
    parts = -xp.log(xp.maximum(right, 1e-7))
    far = xp.abs(away[:, 1:3])
    parts[:, 1:3] = xp.where(far < 1, far * far / 2, far - 0.5)
    return float((signs * parts).sum() / count), back / count


def batches(
    crops: NDArray[np.float16], wanted: NDArray[np.float16], steps: int, seed: int, xp: Any
) -> Iterator[tuple[Any, Any]]:
    """Yield batches, in a random order, every second one mirrored: a mirrored cell is one, too."""
    rng = np.random.default_rng((seed, 1))
    order: list[int] = []
    size = min(AT_ONCE, len(crops))
    seen, asked = xp.asarray(crops), xp.asarray(wanted)
    for step in range(steps):
        if len(order) < size:
            order += rng.permutation(len(crops)).tolist()
        now, order = xp.asarray(order[:size]), order[size:]
        batch, maps = seen[now].astype(xp.float32), asked[now].astype(xp.float32)
        if step % 2:
            batch, maps = batch[..., ::-1], maps[:, _MIRROR][..., ::-1].copy()
            maps[:, 1] *= -1
        yield batch, maps


_MIRROR = [0, 1, 2, 6, 7, 8, 3, 4, 5, 9, 10]


def train(pages: int, steps: int, seed: int = SEED, xp: Any = np, jobs: int = 1) -> Network:
    """Return a network that has learned from rendered pages."""
    seeds = [(seed, k) for k in range(pages)]
    if jobs == 1:
        made = list(map(crops_of, seeds))
    else:
        with multiprocessing.Pool(jobs) as pool:
            made = pool.map(crops_of, seeds, chunksize=8)
    crops, wanted = (np.concatenate(each) for each in zip(*made, strict=True))
    print(f"{len(crops)} crops", flush=True)
    network = Network(seed, xp)
    mean = 0.0
    for step, (batch, maps) in enumerate(batches(crops, wanted, steps, seed, xp)):
        rate = RATE * min(1.0, (step + 1) / WARM) * 0.5 * (1 + np.cos(np.pi * step / steps))
        loss = network.learn(batch, maps, float(rate))
        mean = loss if not step else 0.99 * mean + 0.01 * loss
        if not step % 200 or step == steps - 1:
            print(f"step {step}: loss {mean:.4f}", flush=True)
    return network


def main() -> None:
    """Train, and write the weights."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("--pages", type=int, default=PAGES)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--jobs", type=int, default=multiprocessing.cpu_count())
    parser.add_argument("--gpu", action="store_true")
    given = parser.parse_args()
    xp: Any = np
    if given.gpu:
        import cupy as xp
    train(given.pages, given.steps, given.seed, xp, given.jobs).save(given.output)


if __name__ == "__main__":
    main()
