r"""Checkpoints that are either whole or absent."""

from typing import Any

from lightning.fabric.plugins import TorchCheckpointIO

from torch_geometric_tactile.files import atomic_path
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
        with atomic_path(path) as temporary:
            super().save_checkpoint(checkpoint, temporary, storage_options)
