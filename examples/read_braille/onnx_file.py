"""The network that finds cells of Braille as an ONNX file: convolutions, some of them added up.

ONNX is written as its public definition has it (``onnx.proto``, version 8 of the format, operators
of version 13), in the wire format of Protocol Buffers.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_FLOAT, _FLOAT16, _INTEGERS = 1, 10, 7  # of ``TensorProto.DataType`` and ``AttributeType``

Layer = tuple[NDArray[np.float32], NDArray[np.float32]]


def network_bytes(layers: Sequence[Layer], halved: int, dilations: Sequence[int]) -> bytes:
    """Return the file of a network: weights, (D, C, K, K), and biases, (D,), of each layer.

    The first layers, two of which have half as many positions (``halved`` layers in all), follow
    each other; the output of each of the next, with its dilation, is added to its input; the last
    one makes the maps.
    """
    nodes, tensors, image = b"", b"", "picture"
    for k, (weights, bias) in enumerate(layers):
        last, added = k == len(layers) - 1, halved <= k < len(layers) - 1
        stride = 2 if 0 < k < halved else 1
        dilation = dilations[k - halved] if added else 1
        size = weights.shape[-1]
        names = [f"weights{k}", f"bias{k}"]
        tensors += _tensor(names[0], weights.astype(np.float16)) + _tensor(names[1], bias)
        made = "maps" if last else f"made{k}"
        nodes += _node(
            "Conv", [image, *names], made, kernel_shape=[size] * 2, strides=[stride] * 2,
            dilations=[dilation] * 2, pads=[dilation * (size // 2)] * 4,
        )  # fmt: skip
        if not last:
            nodes += _node("Relu", [made], f"fired{k}")
        if added:
            nodes += _node("Add", [image, f"fired{k}"], f"sum{k}")
        image = f"sum{k}" if added else f"fired{k}"
    ends = _value(11, "picture", [1, 1, 224, 224]) + _value(12, "maps", [1, 9, 56, 56])
    graph = nodes + _field(2, "cells") + tensors + ends
    return _field(1, 8) + _field(7, graph) + _field(8, _field(1, "") + _field(2, 13))


def _field(number: int, value: int | str | bytes) -> bytes:
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    data = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _varint(number: int) -> bytes:
    made = []
    while number > 127:
        made.append(number & 127 | 128)
        number >>= 7
    return bytes([*made, number])


def _node(kind: str, inputs: Sequence[str], output: str, **options: Sequence[int]) -> bytes:
    made = b"".join(_field(1, each) for each in inputs) + _field(2, output) + _field(4, kind)
    for name, values in options.items():
        numbers = b"".join(_field(8, each) for each in values)
        made += _field(5, _field(1, name) + numbers + _field(20, _INTEGERS))
    return _field(1, made)


def _tensor(name: str, array: NDArray[np.floating]) -> bytes:
    kind = _FLOAT16 if array.dtype == np.float16 else _FLOAT
    sizes = b"".join(_field(1, each) for each in array.shape)
    return _field(5, sizes + _field(2, kind) + _field(8, name) + _field(9, array.tobytes()))


def _value(number: int, name: str, sizes: Sequence[int]) -> bytes:
    shape = b"".join(_field(1, _field(1, each)) for each in sizes)
    kind = _field(1, _field(1, _FLOAT) + _field(2, shape))
    return _field(number, _field(1, name) + _field(2, kind))
