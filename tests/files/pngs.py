"""PNG files written chunk by chunk, so that anything can be wrong with them."""

import struct
import zlib

import numpy as np


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(samples: np.ndarray, color_type: int, depth: int = 8, *extra: tuple[bytes, bytes], idat=None) -> bytes:
    """Encode rows that are already packed into bytes, uint8 [H bytes]."""
    channels = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[color_type]
    rows = np.ascontiguousarray(samples).reshape(samples.shape[0], -1).view(np.uint8)
    width = rows.shape[1] * 8 // (depth * channels)
    raw = np.insert(rows, 0, 0, axis=1).tobytes() if idat is None else idat
    header = struct.pack(">2I5B", width, len(rows), depth, color_type, 0, 0, 0)
    parts = [(b"IHDR", header), *extra, (b"IDAT", zlib.compress(raw)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts)
