"""Frames that benchmarks share: letters and random points."""

import numpy as np

from smarttouch.profile import load_profile

LETTERS = {
    "A": "01110 10001 10001 11111 10001 10001 10001",
    "B": "11110 10001 10001 11110 10001 10001 11110",
    "C": "01110 10001 10000 10000 10000 10001 01110",
    "D": "11110 10001 10001 10001 10001 10001 11110",
    "E": "11111 10000 10000 11110 10000 10000 11111",
    "F": "11111 10000 10000 11110 10000 10000 10000",
    "G": "01110 10001 10000 10111 10001 10001 01111",
    "H": "10001 10001 10001 11111 10001 10001 10001",
    "I": "01110 00100 00100 00100 00100 00100 01110",
    "J": "00111 00010 00010 00010 00010 10010 01100",
    "K": "10001 10010 10100 11000 10100 10010 10001",
    "L": "10000 10000 10000 10000 10000 10000 11111",
    "M": "10001 11011 10101 10101 10001 10001 10001",
    "N": "10001 11001 10101 10011 10001 10001 10001",
    "O": "01110 10001 10001 10001 10001 10001 01110",
    "P": "11110 10001 10001 11110 10000 10000 10000",
    "Q": "01110 10001 10001 10001 10101 10010 01101",
    "R": "11110 10001 10001 11110 10100 10010 10001",
    "S": "01111 10000 10000 01110 00001 00001 11110",
    "T": "11111 00100 00100 00100 00100 00100 00100",
    "U": "10001 10001 10001 10001 10001 10001 01110",
    "V": "10001 10001 10001 10001 10001 01010 00100",
    "W": "10001 10001 10001 10101 10101 11011 10001",
    "X": "10001 10001 01010 00100 01010 10001 10001",
    "Y": "10001 10001 01010 00100 00100 00100 00100",
    "Z": "11111 00001 00010 00100 01000 10000 11111",
}
"""Our own drawing, 5 x 7."""


def drawn(letter, rows=8, columns=8):
    level = np.zeros((rows, columns))
    picture = np.array([[int(each) for each in row] for row in LETTERS[letter].split()])
    top, left = max((rows - 7) // 2, 0), max((columns - 5) // 2, 0)
    level[top : top + 7, left : left + 5] = picture
    return level.ravel()


def scattered(points, sites, seed):
    level = np.zeros(sites)
    level[np.random.default_rng(seed).choice(sites, points, replace=False)] = 1.0
    return level


def array_named(name, quick, changed):
    """Return a shipped profile, or an electric mouse of "16x16" electrodes, 8 x 8 where quick."""
    if not name[0].isdigit():
        return load_profile(name)
    rows, columns = (8, 8) if quick else map(int, name.split("x"))
    keys = {"array.rows": rows, "array.columns": columns, "name": f"{rows}x{columns}"}
    return changed(load_profile("electric-mouse"), keys)
