"""The parts of the program ``examples/read_braille``."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "examples" / "read_braille"))

import train_network
from embossed_pages import emboss, printed, random_lines
from onnx_file import network_bytes

__all__ = ["emboss", "network_bytes", "printed", "random_lines", "train_network"]
