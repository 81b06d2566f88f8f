"""Image files of a recording: found, checked before the first tick, decoded into the caller's buffer."""

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wingbeat.errors import InputError

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_TRAILER = b"IEND\xaeB`\x82"
_GREY = 0
_KINDS = {2: "colour", 3: "palette", 4: "grey with transparency", 6: "colour with transparency"}


def find_images(folder: Path, pattern: str) -> list[Path]:
    """Files that match the pattern, sorted by name. Raises InputError if none does."""
    base = Path(pattern)
    try:
        if base.is_absolute():
            found = list(Path(base.anchor).glob(str(base.relative_to(base.anchor))))
        else:
            found = list(folder.glob(pattern))
    except (ValueError, NotImplementedError) as error:
        raise InputError(f"is no pattern of file names: {error}", pattern, 'use one such as "left/*.png"') from None
    if not found:
        raise InputError("no image matches this pattern", folder / pattern, "correct the pattern or the folder")
    return sorted(found, key=lambda path: path.as_posix())


def check_images(paths: Sequence[Path], width: int, height: int) -> np.dtype[Any]:
    """Read the header and the end of each file; return the pixel type that all share: uint8 or uint16.

    Raises InputError: unreadable, truncated, no PNG, colour, or another size or depth than the rest.
    """
    depths = [_check_header(path, width, height) for path in paths]
    odd = next((i for i, depth in enumerate(depths) if depth != depths[0]), None)
    if odd is not None:
        raise InputError(
            f"has {depths[odd]} bits a pixel, but {paths[0].name} has {depths[0]}",
            paths[odd],
            "all images of a camera have the same depth",
        )
    return np.dtype(np.uint8 if depths[0] == 8 else np.uint16)


def read_image(path: Path, out: NDArray[Any]) -> None:
    """Decode a checked PNG into out (height, width), contiguous, without another image buffer. Raises InputError."""
    # The decoder prints its own complaints; the checksums find a damaged file first.
    if not _checksums_hold(_bytes_of(path)):
        raise InputError("the image is damaged (its checksum is wrong)", path, "copy it again from its source")
    image = cv2.imread(str(path), out, cv2.IMREAD_UNCHANGED)
    if image is None or image.shape != out.shape or image.dtype != out.dtype:
        raise InputError("cannot decode this image", path, "store it again as a grey PNG of 8 or 16 bits")
    if image.ctypes.data != out.ctypes.data:
        np.copyto(out, image)


def _bytes_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read this image: {error.strerror}", path, "check the file") from None


def _check_header(path: Path, width: int, height: int) -> int:
    """Bits a pixel of a grey PNG of this size."""
    try:
        with path.open("rb") as file:
            head = file.read(33)
            size = file.seek(0, 2)
            file.seek(max(0, size - len(_TRAILER)))
            tail = file.read()
    except OSError as error:
        raise InputError(f"cannot read this image: {error.strerror}", path, "check the file") from None
    if len(head) < 33 or not head.startswith(_SIGNATURE):
        raise InputError("is no PNG image", path, "recordings hold grey PNG images of 8 or 16 bits")
    if tail != _TRAILER:
        raise InputError("the image is truncated", path, "copy it again from its source")
    columns, rows, depth, colour = struct.unpack(">IIBB", head[16:26])
    if colour != _GREY or depth not in (8, 16):
        kind = _KINDS.get(colour, f"{depth}-bit grey")
        raise InputError(f"is a {kind} image", path, "grey images of 8 or 16 bits are allowed")
    if (columns, rows) != (width, height):
        raise InputError(
            f"is {columns} x {rows} pixels, but the calibration says {width} x {height}",
            path,
            "use the calibration of these images",
        )
    return int(depth)


def _checksums_hold(data: bytes) -> bool:
    """Whether each chunk of a PNG has its CRC-32."""
    view, place = memoryview(data), len(_SIGNATURE)
    while place + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, place)
        end = place + 8 + length
        if end + 4 > len(data):
            return False
        if zlib.crc32(view[place + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            return False
        place = end + 4
    return place == len(data)
