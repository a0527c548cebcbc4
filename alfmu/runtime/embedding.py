"""The scene inside a WebAssembly component, which reads no files (see `c/wasm/embedded.c`)."""

from __future__ import annotations

import struct
from collections.abc import Iterator

_PAGE, _HEAD = 65536, 8
"""Bytes of a page of memory, and of the header of modules and components."""

_MODULE, _MEMORY, _DATA, _COUNT = 1, 5, 11, 12
"""Section numbers: a module in a component; in a module its memory, its data, and its number of data segments."""


def with_scene(component: bytes, scene: bytes) -> bytes:
    """Return a component whose initial memory is extended by the scene and, before it, its size."""
    made = component[:_HEAD]
    for kind, content in _sections(component):
        held = dict(_sections(content)) if kind == _MODULE else {}
        made += _section(kind, _module(content, scene) if _MEMORY in held else content)
    return made


def _module(module: bytes, scene: bytes) -> bytes:
    """Return a module with its memory extended by the scene, and a data segment that holds it."""
    piece, made, end = struct.pack("<I", len(scene)) + scene, module[:_HEAD], 0
    for kind, content in _sections(module):
        if kind == _MEMORY:
            pages, after = _number(content, 2)
            end = pages * _PAGE
            content = content[:2] + _written(pages + len(piece) // _PAGE + 1) + content[after:]
        elif kind in (_DATA, _COUNT):
            count, after = _number(content, 0)
            content = _written(count + 1) + content[after:]
            if kind == _DATA:
                content += b"\0\x41" + _written(end, signed=True) + b"\x0b" + _written(len(piece)) + piece
        made += _section(kind, content)
    return made


def _sections(binary: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the kinds and contents of sections."""
    at = _HEAD
    while at < len(binary):
        size, begin = _number(binary, at + 1)
        yield binary[at], binary[begin : begin + size]
        at = begin + size


def _section(kind: int, content: bytes) -> bytes:
    return bytes([kind]) + _written(len(content)) + content


def _number(binary: bytes, at: int) -> tuple[int, int]:
    """Return a number read in LEB128, and the index after it."""
    value = shift = 0
    while True:
        value |= (binary[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if binary[at - 1] < 0x80:
            return value, at


def _written(value: int, signed: bool = False) -> bytes:
    """Return the LEB128 bytes of a number that is not negative."""
    made = bytearray()
    while value >= (0x40 if signed else 0x80):
        made.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*made, value])
