"""Photographs of printed pages: perspective, curl, shadow, blur and JPEG, with their truth."""

import numpy as np

from .printed import degrade, print_page, some_lines


def photographs(count):
    """Yield name, flat page and photograph of pages of print, each in another way."""
    for seed in range(count):
        random = np.random.default_rng(seed)
        columns = 1 + seed % 3 // 2
        lines = some_lines(20 * columns, 58 // columns, seed)
        flat = print_page(lines, size_pt=10 + seed % 3, dpi=200, columns=columns)
        strength = {
            "perspective": random.uniform(0.04, 0.14),
            "curvature": random.uniform(0, 4),
            "uneven": random.uniform(0.2, 0.6),
            "blur_px": random.uniform(0.6, 1.2),
        }
        photo = degrade(flat, noise=3, jpeg=30, seed=seed, **strength)
        name = ", ".join(f"{key} {value:.2g}" for key, value in strength.items())
        yield name, flat, photo
