"""Writes small networks in the ONNX format, field by field, so that no library for it is needed."""

from __future__ import annotations

import numpy as np

FLOAT, DOUBLE = 1, 11


def _number(n: int) -> bytes:
    out = b""
    while n > 127:
        out, n = out + bytes([n & 127 | 128]), n >> 7
    return out + bytes([n])


def _field(number: int, value: int | str | bytes) -> bytes:
    if isinstance(value, int):
        return _number(number << 3) + _number(value)
    content = value.encode() if isinstance(value, str) else value
    return _number(number << 3 | 2) + _number(len(content)) + content


def _node(operation: str, inputs: list[str], output: str) -> bytes:
    return _field(
        1, b"".join(_field(1, name) for name in inputs) + _field(2, output) + _field(4, operation)
    )


def _value(field: int, name: str, kind: int, shape: tuple[int, ...]) -> bytes:
    dims = b"".join(_field(1, _field(1, n)) for n in shape)
    return _field(field, _field(1, name) + _field(2, _field(1, _field(1, kind) + _field(2, dims))))


def linear(W, inputs=("markers", "goal"), kind: int = FLOAT) -> bytes:
    """action = flat(first input - second input) @ W, as the bytes of an ONNX file; W (2 N, n)."""
    W = np.asarray(W, dtype=np.float32 if kind == FLOAT else np.float64)
    tensor = _field(
        5,
        b"".join(_field(1, n) for n in W.shape)
        + _field(2, kind)
        + _field(8, "W")
        + _field(9, W.tobytes()),
    )
    nodes = (
        _node("Sub", list(inputs), "d")
        + _node("Flatten", ["d"], "flat")
        + _node("MatMul", ["flat", "W"], "action")
    )
    given = b"".join(_value(11, name, kind, (1, len(W) // 2, 2)) for name in inputs)
    graph = (
        nodes + _field(2, "linear") + tensor + given + _value(12, "action", kind, (1, W.shape[1]))
    )
    return _field(1, 8) + _field(7, graph) + _field(8, _field(2, 13))
