r"""The texts of an MCAP recording that stand in its metadata."""

import json
import zlib
from collections.abc import Mapping

METADATA_NAME = "torch_geometric_tactile"


def texts_checksum(texts: Mapping[str, str]) -> int:
    r"""Returns the CRC-32 of names and texts."""
    return zlib.crc32(json.dumps(sorted(texts.items())).encode())
