r"""Checkpoints that are either whole or absent."""

from typing import Any

import torch
from lightning.fabric.plugins import TorchCheckpointIO

from torch_geometric_tactile.files import atomic_file
from torch_geometric_tactile.typing import PathLike


class AtomicCheckpointIO(TorchCheckpointIO):
    r"""Writes a checkpoint to a temporary name and renames it, so that a kill in the middle leaves
    the checkpoint before it as it was.
    """

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: PathLike, storage_options: Any | None = None
    ) -> None:
        r"""Writes a checkpoint.

        Args:
            checkpoint (dict): Its content.
            path (str or PathLike): The file.
            storage_options (optional): Not supported.
        """
        # Not by the method of TorchCheckpointIO, which writes to a temporary of its own in another
        # folder, where a kill would leave it.
        with atomic_file(path) as file:
            torch.save(checkpoint, file)
