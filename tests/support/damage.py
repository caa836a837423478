"""Files with damage, as a Hypothesis strategy."""

import re
import struct
import zlib

from hypothesis import strategies as st

#: What readers have stumbled over, here or elsewhere.
HOSTILE = (
    b"", b" ", b"\0", b"-1", b"0", b"7", b"1.5", b"nan", b"NaN", b"Infinity", b"-inf", b"1e999", b"1e-320", b"1e308",
    b"9" * 18, b"9" * 5000, b"1" + b"0" * 400, b"0x7fffffffffffffff", b"1_0", "٣".encode(), "²".encode(), b"true",
    b"null", b"[]", b"{}", b"[Infinity]", b"[" * 3000, b'{"a":' * 3000, b"- " * 999, b"]", b"}", b'"', b",", b":",
    b"\n", b"\r", b"\n\n", b"\t", b"#", b"\xff\xfe", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"x" * 70000, b"&a [1, 2]",
    b"*a", b"!!binary x", b"2026-13-45", b"? ", b"/dev/zero", b"pipe", b"..", b".", b"folder", b"\x7f\xff\xff\xff",
    b"\xff\xff\xff\xff",
)  # fmt: skip

#: A number or a word of a text.
_WORD = re.compile(rb"[A-Za-z0-9_.+-]+")


@st.composite
def damaged(draw, whole: bytes) -> bytes:
    """A file with a few bits, words or parts changed, lost or added. Checksums may be right."""
    data = bytearray(whole)
    for _ in range(draw(st.sampled_from((1, 1, 1, 2, 4)))):
        at = draw(st.integers(0, len(data)))
        end = min(len(data), at + draw(st.sampled_from((1, 2, 4, 8, 64, len(data)))))
        kind = draw(st.sampled_from(("bit", "word", "word", "insert", "replace", "lose", "repeat", "number")))
        if kind == "bit" and at < len(data):
            data[at] ^= 1 << draw(st.integers(0, 7))
        elif kind == "word" and (words := list(_WORD.finditer(bytes(data[: 2**16])))):
            start, stop = draw(st.sampled_from(words)).span()
            data[start:stop] = draw(st.sampled_from(HOSTILE))
        elif kind == "insert":
            data[at:at] = draw(st.sampled_from(HOSTILE))
        elif kind == "replace":
            data[at:end] = draw(st.sampled_from(HOSTILE))
        elif kind == "lose":
            del data[at:end]
        elif kind == "repeat":
            data[at:at] = data[at:end]
        elif kind == "number":
            data[at : at + 4] = draw(st.integers(0, 2**32 - 1)).to_bytes(4, draw(st.sampled_from(("big", "little"))))
    found = bytes(data)
    return with_checksums(found) if draw(st.booleans()) else found


def with_checksums(data: bytes) -> bytes:
    """A PNG file with right checksums, as far as its chunks can be told; other files as they are."""
    if not data.startswith(b"\x89PNG\r\n\x1a\n"):
        return data
    fixed, position = bytearray(data), 8
    while position + 12 <= len(fixed):
        (length,) = struct.unpack_from(">I", fixed, position)
        end = position + 8 + length
        if end + 4 > len(fixed):
            break
        struct.pack_into(">I", fixed, end, zlib.crc32(fixed[position + 4 : end]))
        position = end + 4
    return bytes(fixed)
