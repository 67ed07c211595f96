"""Ways to damage the bytes of any file: cut, emptied, bits turned, pieces doubled, zeroed, swapped or overwritten."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

EXTREMES = (
    b"\x00" * 8, b"\xff" * 8, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"nan", b"-1", b"1e999", b"../../", b"\x80",
)  # fmt: skip
"""What pieces are overwritten with: largest and least numbers, words that stand for none, paths."""


def damaged(data: bytes, rounds: int, seed: int) -> Iterator[tuple[str, bytes]]:
    """Yield names and damaged copies of a file's bytes: a few that are always tried, and ``rounds`` random ones."""
    yield "empty", b""
    yield "one byte", data[:1]
    yield "cut in half", data[: len(data) // 2]
    yield "last byte cut", data[:-1]
    yield "twice", data + data
    yield "zeros", bytes(len(data))
    yield "another kind", b"%PDF-1.4 nothing of what you expect\n"
    for number in range(rounds):
        rng = np.random.default_rng([seed, number])
        yield f"random {number}", _random(data, rng)


def _random(data: bytes, rng: np.random.Generator) -> bytes:
    found = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if not found:
            break
        # headers matter more than what they head
        place = int(rng.integers(0, min(len(found), 256 if rng.random() < 0.5 else len(found))))
        size = int(rng.integers(1, 64))
        how = int(rng.integers(5))
        if how == 0:
            found[place] ^= 1 << int(rng.integers(8))
        elif how == 1:
            word = EXTREMES[int(rng.integers(len(EXTREMES)))]
            found[place : place + len(word)] = word
        elif how == 2:
            del found[place : place + size]
        elif how == 3:
            found[place:place] = found[place : place + size]
        else:
            found[place : place + size] = rng.integers(0, 256, size, np.uint8).tobytes()
    return bytes(found)
