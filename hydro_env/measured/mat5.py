"""MAT 5 files: the numbers in them, by the names of variables and of the fields of structures.

SciPy's reader believes what a file says of itself: with one wrong bit in the kind of an element, or in the flags of a matrix, it
reads beyond its memory, and the process ends. The format: MathWorks, MAT-File Format, "Level 5 MAT-File Format". Text, cells,
sparse matrices and objects are passed over.
"""

import zlib
from collections.abc import Iterator
from math import prod
from pathlib import Path
from struct import unpack_from
from typing import Any

import numpy as np

from hydro_env.measured.table import MAX_VALUES, check_size

#: NumPy's types by the kind of an element, and kinds of elements that hold others.
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED = 14, 15
#: Classes of matrices: structures, and those of plain numbers.
_STRUCTURE, _NUMBERS = 2, range(6, 16)
_COMPLEX, _HEADER = 0x800, 128
#: Structures within structures, at most.
_MAX_DEPTH = 50

Element = tuple[int, memoryview]


def read_mat5(path: Path) -> dict[str, np.ndarray]:
    """Matrices of real numbers by name, `log.speed` in a structure. ValueError for a file that is damaged."""
    file = path.read_bytes()
    order = "<" if file[126:128] == b"IM" else ">"
    found: dict[str, np.ndarray] = {}
    size = 0
    for kind, content in _elements(memoryview(file)[_HEADER:], order):
        if kind == _COMPRESSED:
            unpacked = zlib.decompressobj().decompress(content, 8 * MAX_VALUES - size + 9)
            size += len(unpacked)
            check_size(size // 8)
            kind, content = next(_elements(memoryview(unpacked), order))
        if kind == _MATRIX:
            _read_matrix(content, order, "", found)
    return found


def _elements(data: memoryview, order: str) -> Iterator[Element]:
    """Kind and content of the elements that stand one behind the other."""
    at = 0
    while at < len(data):
        if at + 8 > len(data):
            raise ValueError(f"byte {at}: it ends where an element should begin")
        kind, length = unpack_from(f"{order}II", data, at)
        start, end = at + 8, at + 8 + length
        if kind >> 16:  # a short one: kind and length share a word, and the data are in the other
            kind, length = kind & 0xFFFF, kind >> 16
            start, end = at + 4, at + 4 + length
        following = at + 8 if start < at + 8 else end if kind == _COMPRESSED else at + 8 + -(-length // 8) * 8
        if end > min(following, len(data)):
            raise ValueError(f"byte {at}: an element of {length} bytes is longer than what it lies in")
        yield kind, data[start:end]
        at = following


def _read_matrix(data: memoryview, order: str, name: str, found: dict[str, np.ndarray]) -> None:
    """Puts a matrix of real numbers into `found`, of a structure what it holds; `name` is what the structure calls it."""
    if not data:
        return
    if name.count(".") > _MAX_DEPTH:
        raise ValueError(f"more than {_MAX_DEPTH} structures lie in each other")
    flags, sizes, own, *rest = _elements(data, order)
    flag = int(_numbers(flags, order)[0])
    shape = [int(size) for size in _numbers(sizes, order)]
    name = name or bytes(own[1]).decode("ascii", "replace")
    if flag & 0xFF == _STRUCTURE and prod(shape) == 1:
        (length, *_), names = _numbers(rest[0], order), bytes(rest[1][1])
        fields = [names[at : at + length].split(b"\0")[0] for at in range(0, len(names), length)]
        for field, (kind, content) in zip(fields, rest[2:], strict=True):
            if kind == _MATRIX:
                _read_matrix(content, order, f"{name}.{field.decode('ascii', 'replace')}", found)
    elif flag & 0xFF in _NUMBERS and not flag & _COMPLEX:
        found[name] = _numbers(rest[0], order).reshape(shape, order="F")


def _numbers(element: Element, order: str) -> Any:
    kind, content = element
    if kind not in _TYPES or len(content) % np.dtype(_TYPES[kind]).itemsize:
        raise ValueError(f"{len(content)} bytes of kind {kind} are no numbers")
    return np.frombuffer(content, order + _TYPES[kind])
