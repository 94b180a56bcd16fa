"""Numbers of a note, whatever its words."""

import re


def numbers_in(text):
    """Return the numbers of a text, in their order; those in words, as in x2, do not count."""
    return [float(each) for each in re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?", text)]
