r"""Saves, restores and seeds the random states of Python, NumPy and PyTorch on the CPU."""

import hashlib
import random
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from numpy.random.mtrand import get_bit_generator, set_bit_generator
from torch import Tensor

# Errors that the generators raise for a state that was edited or damaged.
_STATE_ERRORS = (
    AttributeError,
    IndexError,
    KeyError,
    OverflowError,
    RuntimeError,
    TypeError,
    ValueError,
)
_SEEDED_BITS = np.random.MT19937(0)  # shared, since creating one takes as long as a batch


class RandomStates(NamedTuple):
    r"""The states of the global sources of random numbers."""

    torch: Tensor
    numpy: dict[str, Any]
    python: tuple[Any, ...]

    @classmethod
    def now(cls) -> Self:
        r"""Returns the current states."""
        numpy = np.random.get_state(legacy=False)  # noqa: NPY002 - the global state
        return cls(torch.get_rng_state(), dict(numpy), random.getstate())

    def restore(self) -> None:
        r"""Sets the global states to these states."""
        torch.set_rng_state(self.torch)
        np.random.set_state(self.numpy)  # noqa: NPY002
        random.setstate(self.python)

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the states as plain values and tensors, for a checkpoint."""
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
        r"""Returns the states from the output of :meth:`to_dict`.

        Raises:
            ValueError: If :obj:`content` does not hold valid states.
        """
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
            with preserve_random_states():
                states.restore()
        except _STATE_ERRORS as error:
            raise ValueError(
                f"the random states must be valid for PyTorch, NumPy and Python (got {error!r})"
            ) from error
        return states


@contextmanager
def preserve_random_states() -> Iterator[None]:
    r"""Restores the random states of Python, NumPy and PyTorch on the CPU at the end of the block,
    so that the block does not affect later random numbers.
    """
    states = RandomStates.now()
    try:
        yield
    finally:
        states.restore()


@contextmanager
def seeded_rng(seed: int, generators: Sequence[torch.Generator] = ()) -> Iterator[None]:
    r"""Seeds Python, NumPy, PyTorch on the CPU and the generators within the block, and restores
    their states at the end. The only exception is that NumPy loses a cached second normal number.
    """
    torch_state, python_state = torch.get_rng_state(), random.getstate()
    states = [generator.get_state() for generator in generators]
    # Replaces NumPy's bit generator, since reading its state would take longer than a batch.
    numpy_bits = get_bit_generator()
    set_bit_generator(_SEEDED_BITS)
    try:
        torch.default_generator.manual_seed(seed)
        random.seed(seed)
        np.random.seed(seed % 2**32)  # noqa: NPY002
        for generator in generators:
            generator.manual_seed(mix_seeds(seed, generator.initial_seed()))
        yield
    finally:
        torch.set_rng_state(torch_state)
        random.setstate(python_state)
        set_bit_generator(numpy_bits)
        for generator, state in zip(generators, states, strict=True):
            generator.set_state(state)


def mix_seeds(*numbers: int) -> int:
    r"""Returns a 63-bit seed that depends on all numbers."""
    digest = hashlib.blake2b(repr(numbers).encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") >> 1  # in the range of every generator
