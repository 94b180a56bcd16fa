"""C header of kernels, for firmware that keeps them in its program."""

import hashlib
from collections.abc import Iterable

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.base.version import __version__
from smarttouch.base.whole_kernels import kept_kernels, quantized

_HEAD = """\
/* Kernels as SmartTouch {version} gives them to boards. Positive is cathodic.
 *
 * Row k drives one class at electrode st_table_site[k]; masked electrodes have rows of zeros. At
 * an amplitude of a quarters of a microampere at its strongest electrode, electrode e gets the
 * difference of two sums, rounded to whole microamperes, halves upward:
 *     current_ua(e) = S(e) - S(e - 1), S(e) = floor((a * (w[0] + ... + w[e]) + 65536) / 131072)
 * so that all currents add up to zero (add_up in firmware/src/st_sequence.c does just that).
 * st_table_image is the same table as the payloads of KERNELS carry it (docs/reference/link.md),
 * and st_table_identity its name there: a board that begins with it needs no transfer.
 */
#ifndef ST_KERNEL_TABLE_H
#define ST_KERNEL_TABLE_H

#include <stdint.h>

#define ST_KERNEL_ELECTRODES {electrodes}
#define ST_KERNEL_COUNT {count}
#define ST_KERNEL_IMAGE_BYTES {size}
{classes}
"""
_WIDTH = 96
_IDENTITY_BYTES = 16


def c_header(weights: dict[Afferent, np.ndarray]) -> str:
    """Return the header of the kernels (E, E) of each class."""
    made = {each: quantized(np.asarray(weights[each], np.float64)) for each in sorted(weights)}
    table = np.concatenate([*made.values()])
    electrodes = table.shape[1]
    site = np.concatenate([np.arange(len(own)) for own in made.values()]).astype(np.uint16)
    data, count = kept_kernels(table, site, np.inf, len(table))
    first = np.cumsum([0, *map(len, made.values())]).tolist()
    classes = "\n".join(
        f"#define ST_KERNEL_{each.name} {at} /* row of electrode 0 */"
        for each, at in zip(made, first, strict=False)
    )
    head = _HEAD.format(
        version=__version__, electrodes=electrodes, count=count, size=len(data), classes=classes
    )
    identity = hashlib.sha256(data).digest()[:_IDENTITY_BYTES]
    rows = ",\n".join("    {" + _lines(own, "      ").strip() + "}" for own in table.tolist())
    return (
        f"{head}\nstatic const int16_t st_table_weight[ST_KERNEL_COUNT][ST_KERNEL_ELECTRODES] = "
        f"{{\n{rows}\n}};\n"
        "static const uint16_t st_table_site[ST_KERNEL_COUNT] = "
        f"{{\n{_lines(site.tolist())}\n}};\n"
        f"static const uint8_t st_table_identity[{_IDENTITY_BYTES}] = "
        f"{{\n{_lines(identity)}\n}};\n"
        f"static const uint8_t st_table_image[ST_KERNEL_IMAGE_BYTES] = {{\n{_lines(data)}\n}};\n"
        "#endif\n"
    )


def _lines(numbers: Iterable[int], indent: str = "    ") -> str:
    lines, line = [], indent
    for number in numbers:
        word = f"{number}, "
        if len(line) + len(word) > _WIDTH:
            lines.append(line.rstrip())
            line = indent
        line += word
    return "\n".join([*lines, line.rstrip().rstrip(",")])
