r"""A matrix of readings as a grey PNG image."""

import struct
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np

from torch_geometric_tactile._files import UNREADABLE, existing_file, unreadable
from torch_geometric_tactile._limits import PNG_BYTES
from torch_geometric_tactile._typing import PathLike

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY = 0
_COLORS = {2: "RGB", 3: "a palette", 4: "grey with transparency", 6: "RGB with transparency"}
_DEPTHS = (8, 16)
_MODES = ("L", "I;16", "I")  # the last one is what older versions of Pillow take 16 bits for


def read_matrix_png(path: PathLike, size: Sequence[int] = (32, 32)) -> np.ndarray:
    r"""Reads a grey image of 8 or 16 bits. Its size is checked before it is unpacked, and every
    part is compared with its checksum. Colour images are refused, since nothing says how to convert
    them to grey.

    Args:
        path (str or PathLike): The file.
        size (sequence of int): Number of rows and of columns.

    Returns:
        numpy.ndarray: The grey values :math:`(1, rows, columns)`, of type uint8 or uint16.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If Pillow is missing.
        ValueError: If the file is no PNG image, cut or damaged, too large, of another size or
            depth, coloured, or an animation. The message names the file.

    Examples:
        >>> import tempfile
        >>> from PIL import Image
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     Image.fromarray(np.uint8([[0, 128, 255]])).save(f"{folder}/press.png")
        ...     read_matrix_png(f"{folder}/press.png", size=(1, 3))
        array([[[  0, 128, 255]]], dtype=uint8)
    """
    path = existing_file(path, "give the path of a PNG file")
    if path.stat().st_size > PNG_BYTES:
        raise ValueError(
            f"'{path}' must have {PNG_BYTES} bytes at most, as a small image has (got "
            f"{path.stat().st_size})"
        )
    data = path.read_bytes()
    depth = _checked_depth(path, data, tuple(size))
    try:
        pixels = _pixels(data, tuple(size))
    except UNREADABLE as error:
        raise unreadable(path, "PNG", error) from error
    return pixels.astype(np.uint8 if depth == 8 else np.uint16)[None]


def _checked_depth(path: Path, data: bytes, size: tuple[int, ...]) -> int:
    # The header is the first part of a PNG file, and has one form.
    if data[:8] != _SIGNATURE or data[8:16] != b"\x00\x00\x00\rIHDR" or len(data) < 33:
        raise ValueError(f"'{path}' must be a PNG image (got another format, or a part of one)")
    columns, rows, depth, color = struct.unpack(">IIBB", data[16:26])
    if (rows, columns) != size:
        wanted = " x ".join(map(str, size))
        raise ValueError(f"'{path}' must have {wanted} pixels (got {rows} x {columns})")
    if color != _GREY:
        raise ValueError(
            f"'{path}' must be a grey image (got {_COLORS.get(color, f'colours of type {color}')}):"
            " save it in grey"
        )
    if depth not in _DEPTHS:
        raise ValueError(f"'{path}' must have 8 or 16 bits a pixel (got {depth})")
    return int(depth)


def _pixels(data: bytes, size: tuple[int, ...]) -> np.ndarray:
    try:
        from PIL import Image
    except ImportError as error:
        raise ImportError(
            'PNG images need Pillow: pip install "torch-geometric-tactile[io]"'
        ) from error

    try:
        with Image.open(BytesIO(data), formats=["PNG"]) as image:
            image.verify()  # decoding alone does not compare the checksums of the pixels
        with Image.open(BytesIO(data), formats=["PNG"]) as image:
            if image.size != size[::-1]:  # of a second header
                raise ValueError(f"it must hold one size (got {image.size[::-1]}, too)")
            if getattr(image, "n_frames", 1) > 1:
                raise ValueError("it must hold one image (got an animation)")
            if image.mode not in _MODES:
                raise ValueError(f"it must be a grey image (got mode {image.mode})")
            return np.asarray(image)
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from error
