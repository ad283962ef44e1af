r"""The random states of Python, NumPy and PyTorch's CPU: kept, written down or set for a batch."""

import hashlib
import random
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from numpy.random.mtrand import get_bit_generator, set_bit_generator
from torch import Tensor

# What a state that was changed makes its source raise.
_UNFIT = (AttributeError, IndexError, KeyError, OverflowError, RuntimeError, TypeError, ValueError)
_SEEDED = np.random.MT19937(0)  # making one takes as long


class RandomStates(NamedTuple):
    r"""The states of the global sources of random numbers."""

    torch: Tensor
    numpy: dict[str, Any]
    python: tuple[Any, ...]

    @classmethod
    def now(cls) -> Self:
        r"""Returns the states as they are."""
        numpy = np.random.get_state(legacy=False)  # noqa: NPY002 - the global state
        return cls(torch.get_rng_state(), dict(numpy), random.getstate())

    def restore(self) -> None:
        r"""Makes them the states again."""
        torch.set_rng_state(self.torch)
        np.random.set_state(self.numpy)  # noqa: NPY002
        random.setstate(self.python)

    def to_dict(self) -> dict[str, Any]:
        r"""Returns them as plain values and tensors, for a checkpoint."""
        version, numbers, gauss = self.python
        inner = self.numpy["state"]
        return {
            "torch": self.torch,
            "numpy": {
                "key": torch.from_numpy(inner["key"].astype(np.int64)),
                "pos": int(inner["pos"]),
                "has_gauss": int(self.numpy["has_gauss"]),
                "gauss": float(self.numpy["gauss"]),
            },
            "python": {"version": version, "numbers": torch.tensor(numbers), "gauss": gauss},
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        r"""Returns the states that :meth:`to_dict` wrote down."""
        try:
            numpy, python = content["numpy"], content["python"]
            key = numpy["key"].cpu().numpy().astype(np.uint32)
            states = cls(
                content["torch"].cpu(),
                {
                    "bit_generator": "MT19937",
                    "state": {"key": key, "pos": numpy["pos"]},
                    "has_gauss": numpy["has_gauss"],
                    "gauss": numpy["gauss"],
                },
                (python["version"], tuple(python["numbers"].tolist()), python["gauss"]),
            )
            with kept_rng():
                states.restore()
        except _UNFIT as error:
            raise ValueError(
                f"the random states must be those of PyTorch, NumPy and Python (got {error!r})"
            ) from error
        return states


@contextmanager
def kept_rng() -> Iterator[None]:
    r"""Restores the random states of Python, NumPy and PyTorch's CPU at the end, such that what is
    done within does not change what is drawn after it.
    """
    states = RandomStates.now()
    try:
        yield
    finally:
        states.restore()


@contextmanager
def seeded_rng(seed: int, generators: Sequence[torch.Generator] = ()) -> Iterator[None]:
    r"""Lets all that is drawn within follow from a seed, and nothing that is drawn after it, except
    that NumPy forgets the second of two normal numbers, which it draws together.
    """
    before, python = torch.get_rng_state(), random.getstate()
    states = [generator.get_state() for generator in generators]
    # Another bit generator in place of NumPy's: reading its state would take longer than a batch.
    numpy = get_bit_generator()
    set_bit_generator(_SEEDED)
    try:
        torch.default_generator.manual_seed(seed)
        random.seed(seed)
        np.random.seed(seed % 2**32)  # noqa: NPY002
        for generator in generators:
            generator.manual_seed(mixed(seed, generator.initial_seed()))
        yield
    finally:
        torch.set_rng_state(before)
        random.setstate(python)
        set_bit_generator(numpy)
        for generator, state in zip(generators, states, strict=True):
            generator.set_state(state)


def mixed(*numbers: int) -> int:
    r"""Returns a seed that follows from all numbers."""
    digest = hashlib.blake2b(repr(numbers).encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") >> 1  # in the range of every source
