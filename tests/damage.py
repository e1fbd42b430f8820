"""What a power cut, a full disk or a bad sector makes of a file."""

from __future__ import annotations

from hypothesis import strategies as st

__all__ = ["damages"]

#: How much of the file is left: nothing, half, all or any share.
SHARES = st.sampled_from([0.0, 0.5, 1.0]) | st.floats(0.0, 1.0)
#: Bytes that are changed: a place as a share of the length, and the bits that flip.
CHANGES = st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(1, 255)), max_size=8)


def _damaged(whole: bytes, share: float, changes: list[tuple[float, int]]) -> bytes:
    left = bytearray(whole[: round(share * len(whole))])
    for place, bits in changes if left else ():
        left[round(place * (len(left) - 1))] ^= bits
    return bytes(left)


def damages(whole: bytes) -> st.SearchStrategy[bytes]:
    """What is left of a file's content: cut off anywhere, up to eight bytes changed (or, rarely, whole)."""
    return st.builds(_damaged, st.just(whole), SHARES, CHANGES)
