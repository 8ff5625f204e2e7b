"""VDB files put together by hand, after the published layout: headers without any tree."""

import struct


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def entry(name: str, type_name: str, value: bytes) -> bytes:
    return text(name) + text(type_name) + struct.pack("<I", len(value)) + value


def metadata(*entries: bytes) -> bytes:
    return struct.pack("<I", len(entries)) + b"".join(entries)


def vdb(
    *grids: tuple[str, str, bytes],
    version: int = 224,
    has_offsets: int = 1,
    file_metadata: bytes = metadata(),
) -> bytes:
    """A VDB file by the published layout, without trees: grids are (name, type, description)."""
    packed = b" BDV\0\0\0\0" + struct.pack("<IIIB", version, 11, 0, has_offsets)
    if version < 222:
        packed += b"\1"
    packed += b"0" * 36 + file_metadata + struct.pack("<I", len(grids))
    for name, grid_type, description in grids:
        packed += text(name) + text(grid_type) + text("")
        start = len(packed) + 24
        flags = b"" if version < 222 else struct.pack("<I", 2)
        end = start + len(flags) + len(description)
        packed += struct.pack("<qqq", start, end, end) + flags + description
    return packed


SCALE = text("UniformScaleMap") + struct.pack("<15d", *[0.25] * 15)
