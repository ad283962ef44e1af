r"""Asserts that a model returns the same output for a stream and for windows."""

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
    r"""Asserts that a model returns the same output frame by frame as for windows.

    * Starting from :obj:`model.initial_state(batch_size)`, :obj:`model.step(frame, edge_index,
      state)` must return for each frame the same logits as :obj:`model(window, edge_index)` for all
      frames so far.
    * Starting from frame :obj:`model.receptive_field`, the logits must also be the same as for the
      last :obj:`model.receptive_field` frames. A long stream and a window that is cut from it are
      then equivalent. This law does not apply to a model without this attribute, such as a
      recurrent network.

    Call :meth:`~torch.nn.Module.eval` first. The second law is checked if there are more frames
    than :obj:`receptive_field`.

    Args:
        model (torch.nn.Module): The model.
        x (torch.Tensor): Windows :math:`(B, N, C \cdot T)`.
        num_frames (int): Number of frames :math:`T`.
        edge_index (torch.Tensor, optional): Edges that are passed to the model.
        atol (float): The largest allowed difference.

    Raises:
        AssertionError: If the numbers differ.
        ValueError: If :obj:`x` is not a batch of windows of :obj:`num_frames` frames.

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
    receptive_field = getattr(model, "receptive_field", None) or num_frames
    name = type(model).__name__
    with torch.no_grad():
        state = model.initial_state(len(x), device=x.device, dtype=x.dtype)
        for t in range(num_frames):
            out, state = model.step(frames[:, :, t], edge_index, state)
            # The window of all frames so far, and the window of the receptive field.
            first_frames = {0, max(0, t + 1 - receptive_field)}
            for first_frame in sorted(first_frames):
                expected = model(join_frames(frames[:, :, first_frame : t + 1]), edge_index)
                law = (
                    f"{name} must give the same output after frame {t} as on frames "
                    f"{first_frame} to {t}"
                )
                assert_equal_numbers(law, out, expected, atol)
