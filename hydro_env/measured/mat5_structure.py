"""Whether the elements of a MAT 5 file fit into each other, before SciPy reads them.

SciPy's reader believes what a file says of itself: with one wrong bit in the kind of an element, or in the flags of a matrix, it
reads beyond its memory, and the process ends. The format: MathWorks, MAT-File Format, "Level 5 MAT-File Format". Only what says
how long and of what kind something is gets read here; numbers are passed over.
"""

from __future__ import annotations

import io
import zlib
from math import prod
from pathlib import Path
from struct import unpack, unpack_from
from typing import BinaryIO

__all__ = ["check_structure"]

#: Bytes of a number by the kind of its element.
_SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED, _UTF8 = 1, 5, 6, 14, 15, 16
#: Classes of arrays: of other arrays, of text, of numbers; those of others are told apart by nothing that is checked here.
_CELL, _STRUCT, _OBJECT, _TEXT, _SPARSE, _NUMBERS, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, range(6, 16), 16, 17
_COMPLEX, _HEADER = 0x800, 128
#: Arrays within arrays, at most.
_DEEPEST = 50


def check_structure(path: Path) -> None:
    """ValueError if an element of a MAT 5 file is not what it says, or not within the one around it."""
    with open(path, "rb") as file:
        header = file.read(_HEADER)
        order = "<" if header[126:128] == b"IM" else ">"
        end = path.stat().st_size
        while file.tell() < end:
            kind, length, following = _tag(file, end, order)
            if kind == _COMPRESSED:
                unpacked = zlib.decompress(file.read(length))
                own = io.BytesIO(unpacked)
                if _tag(own, len(unpacked), order)[0] == _MATRIX:
                    _array(own, len(unpacked), order, 0)
                following = file.tell()
            elif kind == _MATRIX:
                _array(file, file.tell() + length, order, 0)
            file.seek(following)


def _tag(file: BinaryIO, end: int, order: str) -> tuple[int, int, int]:
    """Kind and length of the element that begins here, whose data then follow, and where the next one begins."""
    at = file.tell()
    head = file.read(8) if at + 8 <= end else b""
    if len(head) < 8:
        raise ValueError(f"byte {at}: it ends where an element should begin")
    kind, length = unpack(f"{order}II", head)
    if kind >> 16:  # a short one: kind and length share a word, and the data are in the other
        kind, length, data, following = kind & 0xFFFF, kind >> 16, at + 4, at + 8
    else:
        data, following = at + 8, at + 8 + (length if kind == _COMPRESSED else -(-length // 8) * 8)
    if data + length > min(end, following):
        raise ValueError(f"byte {at}: an element of {length} bytes is longer than what it lies in")
    file.seek(data)
    return kind, length, following


def _element(
    file: BinaryIO, end: int, order: str, kinds: tuple[int, ...], length: int | None = None
) -> bytes:
    """The data of the element that begins here, which has to be of one of these kinds, and so long if that is known."""
    at = file.tell()
    kind, found, following = _tag(file, end, order)
    if kind not in kinds or (length is not None and found != length):
        raise ValueError(f"byte {at}: an element of kind {kind} and {found} bytes stands where it cannot be")
    data = file.read(found)
    file.seek(following)
    return data


def _values(file: BinaryIO, end: int, order: str, count: int | None) -> None:
    """Passes over an element with so many numbers, or any number of them."""
    at = file.tell()
    kind, length, following = _tag(file, end, order)
    if kind not in _SIZES or (count is not None and length != count * _SIZES[kind]):
        raise ValueError(
            f"byte {at}: {length} bytes of kind {kind} are not the {count} numbers of their array"
        )
    file.seek(following)


def _array(file: BinaryIO, end: int, order: str, depth: int) -> None:
    """Checks the array that begins here, behind its tag."""
    at = file.tell()
    if at == end and depth:  # an empty one
        return
    flags = unpack_from(f"{order}I", _element(file, end, order, (_UINT32,), 8))[0]
    kind = flags & 0xFF
    if kind == _OPAQUE:  # objects of MATLAB, of which nothing is published
        return
    sizes = _element(file, end, order, (_INT32,))
    if len(sizes) < 8 or len(sizes) % 4:
        raise ValueError(f"byte {at}: an array has sizes of {len(sizes)} bytes")
    shape = unpack(f"{order}{len(sizes) // 4}i", sizes)
    if min(shape) < 0:
        raise ValueError(f"byte {at}: an array has the shape {shape}")
    _element(file, end, order, (_INT8, _UTF8))  # its name
    count = prod(shape)
    if kind in _NUMBERS or kind == _TEXT:
        for _ in range(2 if flags & _COMPLEX else 1):
            _values(file, end, order, None if kind == _TEXT else count)
    elif kind == _SPARSE:
        for _ in range(4 if flags & _COMPLEX else 3):
            _values(file, end, order, None)
    elif kind in (_CELL, _STRUCT, _OBJECT, _FUNCTION):
        _arrays(file, end, order, depth, kind, count)
    else:
        raise ValueError(f"byte {at}: an array has the class {kind}, which there is not")


def _arrays(file: BinaryIO, end: int, order: str, depth: int, kind: int, count: int) -> None:
    """Checks the arrays that lie in an array of a kind, behind its name."""
    at = file.tell()
    if depth == _DEEPEST:
        raise ValueError(f"byte {at}: more than {_DEEPEST} arrays lie in each other")
    if kind == _OBJECT:
        _element(file, end, order, (_INT8,))
    if kind in (_STRUCT, _OBJECT):
        longest = unpack(f"{order}i", _element(file, end, order, (_INT32,), 4))[0]
        names = _element(file, end, order, (_INT8,))
        if longest <= 0 or len(names) % longest:
            raise ValueError(f"byte {at}: {len(names)} bytes of names of {longest} each")
        count *= len(names) // longest
    for _ in range(1 if kind == _FUNCTION else count):
        at = file.tell()
        inner, length, following = _tag(file, end, order)
        if inner != _MATRIX:
            raise ValueError(f"byte {at}: an element of kind {inner} stands where an array should be")
        _array(file, file.tell() + length, order, depth + 1)
        file.seek(following)
