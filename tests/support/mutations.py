"""Random damage to files, and scenes with random mistakes."""

from __future__ import annotations

import re

import numpy as np

EXTREMES = (
    b"0",
    b"-1",
    b"1e300",
    b"-1e-300",
    b"nan",
    b"inf",
    b"9" * 40,
    b"''",
    b"[]",
    b"{}",
    b"true",
    b"'1 km'",
    b"1e999",
)


def damaged(data: bytes, random: np.random.Generator) -> bytes:
    """Bytes of which some are other ones, zero, missing, doubled, or from elsewhere in the file."""
    out, size = bytearray(data), len(data)
    start = (
        int(random.integers(size)) if random.random() < 0.5 else int(random.integers(min(size, 4096)))
    )  # or the head
    length = int(random.integers(1, 1 + min(64, size - start)))
    match int(random.integers(8)):
        case 0 | 1 | 2:
            for place in random.integers(start, start + length, size=random.integers(1, 9)):
                out[place] ^= 1 << int(random.integers(8))
        case 3:
            out[start : start + length] = bytes(length)
        case 4:
            out[start : start + length] = b"\xff" * length
        case 5:
            del out[start:]
        case 6:
            del out[start : start + length]
        case _:
            source = int(random.integers(size))
            out[start : start + length] = data[source : source + length].ljust(length, b"\0")
    return bytes(out)


def mistaken(scene: bytes, random: np.random.Generator) -> bytes:
    """The text of a scene with one to three mistakes: values, keys, lines, characters."""
    for _ in range(int(random.integers(1, 4))):
        lines = scene.split(b"\n")
        number = int(random.integers(len(lines)))
        match int(random.integers(6)):
            case 0 | 1:  # another value
                key, equals, _value = lines[number].partition(b"=")
                lines[number] = key + equals + (b" " + EXTREMES[random.integers(len(EXTREMES))] if equals else b"")
            case 2:
                lines[number] = re.sub(rb"\d+", lambda _: str(random.integers(-5, 10**9)).encode(), lines[number])
            case 3:
                del lines[number]
            case 4:
                lines.insert(int(random.integers(len(lines))), lines[number])
            case _:
                lines[number] = damaged(lines[number] or b"=", random)
        scene = b"\n".join(lines)
    return scene
