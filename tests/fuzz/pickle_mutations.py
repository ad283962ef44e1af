"""Mutations of pickles of arrays: of their steps, and of what they hold."""

import pickle
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from fuzz.bytes_mutations import BYTES
from fuzz.laws import REFUSED, REWRITTEN
from fuzz.torch_mutations import Hostile

_STEPS = 400  # bytes at the start of a file, with the steps of its first array
_SHAPE = b"M\x70\x01K\x04\x86"  # (368, 4)
_MANY = b"J\xff\xff\xff\x7f"  # 2**31 - 1
_HUGE = (_MANY + b"K\x04\x86", _MANY + _MANY + b"\x86", b"J\xff\xff\xff\xffK\x04\x86", b"N\x85")


def mutate(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    """There is no checksum: what is flipped may read as another number."""
    kind = draw.randrange(6)
    if kind < 4:
        steps, rest = (data, b"") if kind == 0 else (data[:_STEPS], data[_STEPS:])
        path.write_bytes(draw.choice(BYTES)(steps, draw, other) + rest)
        return REWRITTEN
    protocol = draw.randrange(6)
    if kind == 4 and _SHAPE in data:
        path.write_bytes(data.replace(_SHAPE, draw.choice(_HUGE), 1))
        return REFUSED
    content = pickle.loads(data)  # one of ours
    harm: list[Any] = [
        Hostile(draw),
        np.array([Hostile(draw)], dtype=object),
        np.zeros((368, 4), draw.choice([complex, "V4", "f4,f4", "S3", "U2", "datetime64[s]"])),
        {1, 2},
        np.dtype("O"),
    ]
    if isinstance(content, list):
        content.insert(draw.randrange(len(content)), draw.choice(harm))
    else:
        content = {draw.choice(["joint_states", "other"]): draw.choice(harm[:4]), **content}
        content["joint_states"] = draw.choice(harm)
    path.write_bytes(pickle.dumps(content, protocol))
    return REFUSED
