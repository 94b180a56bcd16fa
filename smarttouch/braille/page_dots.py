"""Dots of one page looked at once more, by what the dots of that page look like.

The network has never seen the page. What it finds for certain is enough to learn from: a linear
discriminant tells dots from the paper between them, and rows of cells have no holes without reason.
"""

import itertools
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.braille.cell_detection import FoundCells, Points, cell_pitch, columns_of, level_rows

FEWEST = 40
"""Fewest cells from which the look of dots is learned."""
_ROUNDS = 3  # cells found in one are learned from in the next
_BEYOND = 2  # cells looked for beyond the ends of a row in each round
_HALF = 5  # half the side of what is seen of a dot; the neighboring dot is as far away
_SEEN = 1.15  # what is seen of a dot, in distances of dots
_SPACINGS = np.arange(0.32, 0.47, 0.02)  # distances of dots that occur, in those of cells
_ANY = (slice(None), slice(None))
_DOTS = np.array([(-0.5, -1), (-0.5, 0), (-0.5, 1), (0.5, -1), (0.5, 0), (0.5, 1)])
_REGULAR = 0.3  # share of the mean variance that is added to each
_NETWORK = 0.7  # weight of the network's opinion beside the page's, where it found a cell
_ADDED = 0.97  # least certainty of one dot at least of a cell that the network did not find
_FOLDS = 5
_LEAST = 1e-6  # of weights and variances, where there are none
_NEAR, _STIFF, _OBSERVED = 2.0, 1.0, 0.7
"""Cells over which a row is smoothed, how little its step may drift, and the weight of a place
that was found beside the row's."""
_MOST_ROWS = 6  # rows without a cell between two that are looked at

Picture = NDArray[np.float32]
Dots = NDArray[np.float64]


class _Places(NamedTuple):
    """Where cells may stand."""

    px: Points  # (N, 2)
    owner: NDArray[np.int_]  # (N,), index of the cell found there, -1 if none


class SeenAgain(NamedTuple):
    """Cells of a page by what its dots look like."""

    found: FoundCells
    agreed: Dots  # (N,) in [0, 1], the network's certainty of each
    light_from_deg: float  # 0 the right, 90 the top of the picture; not a number if unknown


def look_again(found: FoundCells, even: Picture, opinion: Picture) -> SeenAgain:
    """Return the cells of a page by what its dots look like; few cells stay as they are.

    ``even`` is the picture with normalized contrast, ``opinion`` the network's maps, (9, H, W).
    """
    light_deg, agreed, within = float("nan"), found.certainty, _ANY
    for _ in range(_ROUNDS):
        places = _places(found)
        there = places.owner >= 0
        of = places.owner[there]
        dots = (found.patterns[of, None] >> np.arange(6) & 1).astype(bool)
        if len(of) < FEWEST or min(dots.sum(), (~dots).sum()) < FEWEST:
            break
        pitch_px = cell_pitch(found.px)
        half, within = _spacing(even, places.px[there], dots, pitch_px, within)
        at = (places.px[:, None] + _DOTS * half).reshape(-1, 2)
        seen = _sampled(even, at[:, None] + _GRID * (half[0] * _SEEN / _HALF))
        seen = seen.reshape(len(places.px), 6, -1)
        own, look = _by_look(seen, there, dots, found.certainty[of])
        right, down = (look * _MIDDLE) @ _GRID
        light_deg = float(np.degrees(np.arctan2(-down, right)))
        near, told = _opinion_at(opinion, places.px)
        weight = np.where(there, _NETWORK, _NETWORK / 2 * (near > 0.05))[:, None]
        share = 1 / (1 + np.exp(-(weight * told + (1 - weight) * own)))
        on = share > 0.5
        kept = on.any(axis=1) & (there | (np.where(on, share, 0).max(axis=1) > _ADDED))
        found = FoundCells(
            places.px[kept],
            on[kept] @ (1 << np.arange(6)),
            np.maximum(share, 1 - share).prod(axis=1)[kept],
        )
        alike = 1 / (1 + np.exp(np.where(on, -told, told)))
        agreed = (np.maximum(near, 0) * alike.prod(axis=1))[kept]
    return SeenAgain(found, agreed, light_deg)


_GRID = np.stack(np.meshgrid(*[np.arange(-_HALF, _HALF + 1.0)] * 2), axis=-1).reshape(-1, 2)
_MIDDLE = np.exp(-(_GRID**2).sum(axis=1) / _HALF)


def _sampled(picture: Picture, px: Points) -> Dots:
    x, y = np.moveaxis(px.astype(np.float32), -1, 0)
    made = cv2.remap(
        picture, x.reshape(len(x), -1), y.reshape(len(y), -1), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REFLECT,
    )  # fmt: skip
    return np.asarray(made, float).reshape(x.shape)


def _spacing(
    even: Picture, px: Points, dots: NDArray[np.bool_], pitch_px: float, within: tuple[slice, slice]
) -> tuple[Points, tuple[slice, slice]]:
    """Return the distances of dots, across and down, px, at which they differ most from paper, of
    those ``within`` parts of the usual ones; and the parts around them."""
    soft = np.asarray(cv2.GaussianBlur(even, (0, 0), 1.2), np.float32)
    best, chosen = -1.0, (0, 0)
    heights = np.array([(0, -3), (0, -1), (0, 1), (0, 3)])
    every = np.arange(len(_SPACINGS))
    for across, down in itertools.product(every[within[0]], every[within[1]]):
        half = _SPACINGS[[across, down]] * pitch_px
        at = (px[:, None] + _DOTS * half).reshape(-1, 1, 2) + heights
        seen = _sampled(soft, at)
        step = seen[dots.ravel()].mean(axis=0) - seen[~dots.ravel()].mean(axis=0)
        apart = step @ np.linalg.solve(np.cov(seen.T) + 0.01 * np.eye(4), step)
        if apart > best:
            best, chosen = apart, (int(across), int(down))
    first, second = (slice(max(0, k - 1), k + 2) for k in chosen)
    return _SPACINGS[list(chosen)] * pitch_px, (first, second)


def _by_look(
    seen: Dots, there: NDArray[np.bool_], dots: NDArray[np.bool_], certainty: Dots
) -> tuple[Dots, Dots]:
    """Return log odds of dots, (N, 6), each from other cells than its own, and how a dot differs
    from paper, (K,)."""
    odds = np.zeros(seen.shape[:2])
    known = np.zeros(seen.shape[:2], bool)
    known[there] = dots
    weight = np.zeros(seen.shape[:2])
    weight[there] = certainty[:, None] + _LEAST
    fold = np.arange(len(seen)) % _FOLDS
    for each in range(_FOLDS):
        rest, now = there & (fold != each), fold == each
        odds[now] = _discriminant(
            seen[rest].reshape(-1, seen.shape[2]), known[rest].ravel(), weight[rest].ravel(),
            seen[now],
        )  # fmt: skip
    on, off = seen[there][dots].mean(axis=0), seen[there][~dots].mean(axis=0)
    return np.clip(odds, -8, 8), on - off


def _discriminant(seen: Dots, dot: NDArray[np.bool_], weight: Dots, asked: Dots) -> Dots:
    """Return the log odds of dots by Fisher's discriminant of those known."""
    weight = weight / weight.sum()
    middle = weight @ seen
    away = seen - middle
    spread = (away * weight[:, None]).T @ away
    spread += (_REGULAR * np.trace(spread) / len(spread) + _LEAST) * np.eye(len(spread))
    dots, paper = weight @ dot + _LEAST, weight @ ~dot + _LEAST
    on, off = weight * dot / dots, weight * ~dot / paper
    axis = np.linalg.solve(spread, (on - off) @ away)
    along = away @ axis
    high, low = on @ along, off @ along
    variance = (on @ (along - high) ** 2 + off @ (along - low) ** 2) / 2
    slope = (high - low) / max(float(variance), 1e-9)
    odds: Dots = slope * ((asked - middle) @ axis - (high + low) / 2)
    return odds + np.log(dots / paper)


def _opinion_at(opinion: Picture, px: Points) -> tuple[Dots, Dots]:
    """Return the network's certainty of a cell near places, (N,), and log odds of its dots."""
    height, width = opinion.shape[1:]
    best, odds = np.full(len(px), -1.0), np.zeros((len(px), 6))
    middle = np.rint((px - 1.5) / 4).astype(int)
    for right, down in np.ndindex(3, 3):
        column = np.clip(middle[:, 0] + right - 1, 0, width - 1)
        row = np.clip(middle[:, 1] + down - 1, 0, height - 1)
        share = np.clip(opinion[3:, row, column].T, 1e-3, 1 - 1e-3)
        better = opinion[0, row, column] > best
        best = np.where(better, opinion[0, row, column], best)
        odds = np.where(better[:, None], np.log(share / (1 - share)), odds)
    return best, odds


def _places(found: FoundCells) -> _Places:
    """Return the places of the cells of a page, those in holes of its rows and at their ends."""
    rows, level, to_px = level_rows(found)
    if not rows:
        return _Places(np.zeros((0, 2)), np.zeros(0, int))
    left, right = (edge(level[np.concatenate(rows), 0]) for edge in (np.min, np.max))
    every, owners = [], []
    for row in rows:
        column = np.array(columns_of(level[row, 0]), float)
        step = np.polyfit(column, level[row, 0], 1)[0] if len(row) > 4 else 1.0
        base = level[row[0], 0]
        room = (left - base) / step + 0.3, (right - base) / step - 0.3
        first = int(max(-_BEYOND, np.floor(room[0])))
        last = int(column[-1] + min(_BEYOND, np.ceil(room[1] - column[-1])))
        asked = np.arange(min(first, 0), max(last, int(column[-1])) + 1)
        bent = np.column_stack([(level[row, 0] - base) / step - column, level[row, 1]])
        places = _smoothed(column, bent, asked.astype(float))
        places[:, 0] = (places[:, 0] + asked) * step + base
        index = np.full(len(asked), -1)
        index[column.astype(int) - asked[0]] = row
        there = index >= 0
        places[there] = _OBSERVED * level[row] + (1 - _OBSERVED) * places[there]
        every.append(places)
        owners.append(index)
    between = _between(every)
    px = to_px(np.concatenate([*every, *between]))
    owner = np.concatenate([*owners, *(np.full(len(each), -1) for each in between)])
    return _Places(px, owner.astype(int))


def _smoothed(column: Dots, bent: Points, asked: Dots) -> Points:
    """Return local lines through values at columns, (M, 2), stiffer than the least squares'."""
    away = np.abs(asked[:, None] - column)
    weight = np.exp(-0.5 * (away / _NEAR) ** 2) + 1e-4 * np.exp(-away / 4) + 1e-12
    total = weight.sum(axis=1, keepdims=True)
    weight /= total
    middle, value = weight @ column, weight @ bent
    apart = column - middle[:, None]
    slope = (weight * apart) @ bent - (weight * apart).sum(axis=1)[:, None] * value
    slope /= (weight * apart**2).sum(axis=1)[:, None] + _STIFF
    made: Points = value + slope * (asked - middle)[:, None]
    return made


def _between(rows: list[Points]) -> list[Points]:
    """Return rows of places where there is room for rows between two."""
    gaps = np.diff([np.median(row[:, 1]) for row in rows])
    usual = float(np.median(gaps)) if len(gaps) else 0.0
    made = []
    for above, below, gap in zip(rows, rows[1:], gaps, strict=False):
        count = round(gap / usual) if usual > 1.2 else 1
        x = max(above, below, key=len)[:, 0]
        top, bottom = (np.interp(x, row[:, 0], row[:, 1]) for row in (above, below))
        if count < _MOST_ROWS:
            for each in range(1, count):
                made.append(np.column_stack([x, top + (bottom - top) * each / count]))
    return made
