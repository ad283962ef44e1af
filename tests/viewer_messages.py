"""The viewer's messages, as the page reads them."""

import json
import struct

import numpy as np


def unpack(message):
    """Returns the head and the arrays."""
    (size,) = struct.unpack_from("<I", message)
    head = json.loads(message[4 : 4 + size])
    offset, arrays = 4 + size, {}
    for name, shape in head["arrays"]:
        count = int(np.prod(shape))
        arrays[name] = np.frombuffer(message, "<f4", count, offset).reshape(shape)
        offset += 4 * count
    assert offset == len(message)
    return head, arrays
