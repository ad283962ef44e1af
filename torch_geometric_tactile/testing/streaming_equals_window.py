r"""Frame by frame gives what whole windows give."""

from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile.data import join_frames, split_frames
from torch_geometric_tactile.testing._compare import assert_equal_numbers


def assert_streaming_equals_window(
    model: Any,
    x: Tensor,
    num_frames: int,
    edge_index: Tensor | None = None,
    atol: float = 1e-5,
) -> None:
    r"""Asserts that a model gives on one frame at a time what it gives on windows.

    * Fed from :obj:`model.initial_state(batch_size)` by :obj:`model.step(frame, edge_index,
      state)`, it gives after each frame the logits of :obj:`model(window, edge_index)` on all
      frames so far.
    * From frame :obj:`model.receptive_field` on, it also gives those on the last so many frames: a
      long stream and a window cut from it are the same. A model without this attribute, as a
      recurrent one, need not.

    Call :meth:`~torch.nn.Module.eval` first. The second law is checked if there are more frames
    than :obj:`receptive_field`.

    Args:
        model (torch.nn.Module): The model.
        x (torch.Tensor): Windows :math:`(B, N, C \cdot T)`.
        num_frames (int): Number of frames :math:`T`.
        edge_index (torch.Tensor, optional): Edges, handed on.
        atol (float): The difference that is allowed.

    Raises:
        AssertionError: If the numbers differ.
        ValueError: If :obj:`x` is no batch of windows of so many frames.

    Examples:
        >>> from torch_geometric_tactile.nn import TemporalTaxelNet
        >>> model = TemporalTaxelNet("biotac", 2, in_channels=3, num_blocks=1).eval()
        >>> assert_streaming_equals_window(model, torch.randn(2, 19, 3 * 8), num_frames=8)
    """
    if x.dim() != 3 or x.size(0) == 0:
        raise ValueError(
            "'x' must have shape (batch_size, num_taxels, num_channels * num_frames) with at least "
            f"one window (got {tuple(x.shape)})"
        )
    frames = split_frames(x, num_frames)
    field = getattr(model, "receptive_field", None) or num_frames
    name = type(model).__name__
    with torch.no_grad():
        state = model.initial_state(len(x), device=x.device, dtype=x.dtype)
        for t in range(num_frames):
            out, state = model.step(frames[:, :, t], edge_index, state)
            firsts = {0, max(0, t + 1 - field)}
            for first in sorted(firsts):
                expected = model(join_frames(frames[:, :, first : t + 1]), edge_index)
                law = f"{name} must give after frame {t} what it gives on frames {first} to {t}"
                assert_equal_numbers(law, out, expected, atol)
