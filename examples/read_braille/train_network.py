"""Train the network that finds cells of Braille on rendered pages, from a seed.

    python examples/read_braille/train_network.py network.onnx

makes ``smarttouch/braille/network.onnx``, the same to the bit on the same kind of machine, with
PyTorch (``pip install torch``): in seven minutes on 16 processors and one large graphics card
(H100), half of it for the pages. ``--pages 8 --steps 4 --device cpu`` shows the way. No photograph
goes into it.
"""

import argparse
import itertools
import math
import multiprocessing
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from embossed_pages import emboss, printed, random_lines
from numpy.typing import NDArray
from onnx_file import network_bytes

from smarttouch.braille.cell_detection import STRIDE, evened

SEED, PAGES, STEPS = 1, 12_000, 16_000
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
    lines, back = (
        random_lines(rows, columns, int(rng.integers(1 << 30)),
                     float(rng.choice([0.05, 0.15, 0.4, 0.7, 0.95])), float(rng.uniform(0.2, 0.6)))
        for _ in range(2)
    )  # fmt: skip
    ink = rng.random() < 0.08
    above = float(np.clip(rng.normal(90, 25), 8, 172))
    # Either between the dots of the front, or anywhere.
    usual = rng.random() < 0.5
    shift = rng.normal(0.5, 0.15, 2) if usual else rng.uniform((-1, -1), (1.4, 3.5))
    made = emboss(
        lines,
        px_per_mm=finer * pitch_px / cell_mm,
        light_deg=above if rng.random() < 0.7 else float(rng.uniform(8, 172)),
        skew_deg=float(rng.uniform(-9, 9) if rng.random() < 0.5 else rng.uniform(-2, 2)),
        blur_px=float(rng.choice([0.3, 0.7, 1.2, 2.5])) * finer / 1.5,
        noise=float(rng.choice([1.0, 2.0, 4.0, 10.0])),
        shading=float(rng.uniform(0, 0.6)),
        texture=float(rng.choice([0.3, 0.6, 1.0, 2.0, 4.0])),
        perspective=float(rng.uniform(0, 0.15)),
        curl_mm=float(rng.choice([0.0, 3.0, 6.0, 10.0])),
        back_side=back if rng.random() < 0.65 and not ink else None,
        back_shift=(float(shift[0]), float(shift[1])),
        dent=float(rng.uniform(0.5, 1.15)),
        dot_mm=float(rng.uniform(0.35, 0.44)) * cell_mm,
        cell_mm=cell_mm,
        line_mm=float(rng.uniform(1.45, 1.9)) * cell_mm,
        uneven=float(rng.uniform(0.04, 0.25)),
        lost=float(rng.choice([0.0, 0.0, 0.02, 0.05])),
        quality=int(rng.integers(40, 96)),
        height_mm=float(rng.uniform(0.2, 0.6)),
        radius_mm=float(rng.uniform(0.6, 0.95)),
        elevation_deg=float(rng.uniform(12, 50)),
        ambient=float(rng.uniform(0.15, 0.65)),
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
    if rng.random() < 0.35:
        grey = _stained(np.asarray(grey, np.uint8), rng)
    if rng.random() < 0.5:
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
            words = "".join(rng.choice(list("abcdefghij KLMNOPQR.:;")) for _ in range(24))
            words = words.replace("", " ") if rng.random() < 0.3 else words
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


def _stained(grey: NDArray[np.uint8], rng: Any) -> NDArray[np.uint8]:
    """Return a page with stains, or with handwriting through its cells."""
    darker = np.zeros(grey.shape, np.float32)
    written = rng.random() < 0.4
    for _ in range(int(rng.integers(1, 10))):
        middle = rng.uniform((0, 0), grey.shape[::-1])
        if written:
            steps = rng.normal((6, 0), (4, 9), (int(rng.integers(4, 25)), 2))
            line = np.rint(middle + np.cumsum(steps, axis=0)).astype(np.int32)
            cv2.polylines(darker, [line], False, float(rng.uniform(0.1, 0.5)), 1, cv2.LINE_AA)
            continue
        angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        round_px = np.column_stack([np.cos(angles), rng.uniform(0.3, 1) * np.sin(angles)])
        edge = middle + round_px * rng.uniform(4, 60) * rng.uniform(0.8, 1.2, (16, 1))
        stain = np.zeros(grey.shape, np.float32)
        cv2.fillPoly(stain, [np.rint(edge).astype(np.int32)], float(rng.uniform(0.05, 0.5)))
        darker += cv2.GaussianBlur(stain, (0, 0), float(rng.uniform(0.7, 5)))
    return np.asarray(grey * np.clip(1 - darker, 0.1, 1), np.uint8)


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
    picture = picture * float(rng.uniform(0.4, 1.25)) + float(rng.uniform(0, 40))
    picture += float(rng.choice([0.0, 1.0, 3.0])) * rng.standard_normal(grey.shape)
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


def network(seed: int) -> Any:
    """Return the network with random weights."""
    import torch

    torch.use_deterministic_algorithms(True)
    torch.backends.cudnn.benchmark = False
    torch.manual_seed(seed)
    widths = [1, *WIDTHS, *[WIDTHS[-1]] * len(DILATIONS), 9]
    layers = torch.nn.ModuleList()
    for k, (inside, outside) in enumerate(itertools.pairwise(widths)):
        last, added = k == len(widths) - 2, k >= len(WIDTHS)
        size, dilation = (1, 1) if last else (3, DILATIONS[k - len(WIDTHS)] if added else 1)
        layer = torch.nn.Conv2d(
            inside, outside, size, 2 if 0 < k < len(WIDTHS) else 1, dilation * (size // 2), dilation
        )
        spread = math.sqrt((1 if last else 2) / (inside * size * size))
        # Each layer that is added to what came before begins small.
        torch.nn.init.normal_(layer.weight, std=spread * (0.3 if added and not last else 1))
        torch.nn.init.zeros_(layer.bias)
        layers.append(layer)
    with torch.no_grad():
        layers[-1].bias[0] = -4.0  # cells are rare
    return layers


def maps_of(layers: Any, image: Any) -> Any:
    """Return the maps, (B, 9, H, W), of pictures, (B, 1, 4 H, 4 W)."""
    for k, layer in enumerate(layers[:-1]):
        fired = layer(image).relu()
        image = image + fired if k >= len(WIDTHS) else fired
    return layers[-1](image)


def loss_of(made: Any, wanted: Any) -> Any:
    """Return the loss of maps, (B, 9, H, W), for each cell."""
    from torch.nn.functional import binary_cross_entropy_with_logits as entropy
    from torch.nn.functional import smooth_l1_loss as away

    there, near = wanted[:, 9:10], wanted[:, 10:11]
    lost = (there * entropy(made[:, :1], wanted[:, :1], reduction="none")).sum()
    lost = lost + _OFFSET * (near * away(made[:, 1:3], wanted[:, 1:3], reduction="none")).sum()
    lost = lost + _DOT * (near * entropy(made[:, 3:], wanted[:, 3:9], reduction="none")).sum()
    return lost / wanted[:, :1].sum().clamp(min=1)


def batches(crops: Any, wanted: Any, steps: int, seed: int) -> Iterator[tuple[Any, Any]]:
    """Yield batches, in a random order, every second one mirrored: a mirrored cell is one, too."""
    import torch

    rng = np.random.default_rng((seed, 1))
    order: list[int] = []
    size = min(AT_ONCE, len(crops))
    for step in range(steps):
        if len(order) < size:
            order += rng.permutation(len(crops)).tolist()
        now, order = torch.tensor(order[:size], device=crops.device), order[size:]
        batch, maps = crops[now].float(), wanted[now].float()
        if step % 2:
            batch, maps = batch.flip(2), maps[:, _MIRROR].flip(3)
            maps[:, 1] *= -1
        yield batch[:, None], maps


_MIRROR = [0, 1, 2, 6, 7, 8, 3, 4, 5, 9, 10]


def rendered(pages: int, seed: int, jobs: int) -> tuple[NDArray[np.float16], NDArray[np.float16]]:
    """Return crops of pages, (4 N, 224, 224), and what is wanted of them, (4 N, 11, 56, 56)."""
    with multiprocessing.Pool(jobs, cv2.setNumThreads, (1,)) as pool:
        made = pool.map(crops_of, [(seed, k) for k in range(pages)], chunksize=8)
    crops, wanted = zip(*made, strict=True)
    return np.concatenate(crops), np.concatenate(wanted)


def train(
    crops: NDArray[np.float16], wanted: NDArray[np.float16], steps: int, seed: int, device: str
) -> Any:
    """Return a network that has learned from crops of pages."""
    import torch

    layers = network(seed).to(device, memory_format=torch.channels_last)
    adam = torch.optim.Adam(layers.parameters(), betas=_DECAY)
    seen, asked = (torch.from_numpy(each).to(device) for each in (crops, wanted))
    for step, (batch, maps) in enumerate(batches(seen, asked, steps, seed)):
        rate = RATE * min(1.0, (step + 1) / WARM) * 0.5 * (1 + math.cos(math.pi * step / steps))
        for group in adam.param_groups:
            group["lr"] = rate
        loss = loss_of(maps_of(layers, batch), maps)
        adam.zero_grad()
        loss.backward()
        adam.step()
        if not step % 500 or step == steps - 1:
            print(f"step {step}: loss {loss.item():.4f}", flush=True)
    return layers


def save(layers: Any, path: Path) -> None:
    """Write the network as the package ships it, its weights as half numbers."""
    parts = [
        tuple(part.detach().cpu().numpy() for part in (layer.weight, layer.bias))
        for layer in layers
    ]
    path.write_bytes(network_bytes(parts, len(WIDTHS), DILATIONS))


def main() -> None:
    """Train, and write the weights."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("--pages", type=int, default=PAGES)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--jobs", type=int, default=multiprocessing.cpu_count())
    parser.add_argument("--device", default="cuda", help="a device of PyTorch: cuda or cpu")
    given = parser.parse_args()
    # Without it cuBLAS adds up in an order that may differ from run to run.
    os.environ["CUBLAS_WORKSPACE_CONFIG"] = ":4096:8"
    crops, wanted = rendered(given.pages, given.seed, given.jobs)
    print(f"{len(crops)} crops", flush=True)
    save(train(crops, wanted, given.steps, given.seed, given.device), given.output)


if __name__ == "__main__":
    main()
