r"""Checkpoints that are either complete or absent, and that run nothing."""

from pathlib import Path
from typing import Any

from lightning.fabric.plugins import TorchCheckpointIO

from torch_geometric_tactile._files import check_zip
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._torch_file import write_torch_file
from torch_geometric_tactile.training._checkpoint_file import read_checkpoint


class AtomicCheckpointIO(TorchCheckpointIO):
    r"""Writes checkpoints atomically, so that a process killed while writing leaves the checkpoint
    before it unchanged. Reading compares a checkpoint with its checksums, and loads it as plain
    data unless told otherwise.

    Examples:
        >>> from tempfile import TemporaryDirectory
        >>> files = AtomicCheckpointIO()
        >>> with TemporaryDirectory() as folder:
        ...     files.save_checkpoint({"state_dict": {}, "epoch": 3}, f"{folder}/last.ckpt")
        ...     files.load_checkpoint(f"{folder}/last.ckpt")["epoch"]
        3
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
        write_torch_file(checkpoint, path)

    def load_checkpoint(
        self, path: PathLike, map_location: Any | None = None, weights_only: bool | None = None
    ) -> dict[str, Any]:
        r"""Reads a checkpoint.

        Args:
            path (str or PathLike): The file.
            map_location (optional): Where to put the tensors: where they were if left out.
            weights_only (bool, optional): Only :obj:`False` unpickles objects, which runs what the
                file says.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If it is damaged or no checkpoint.
        """
        if weights_only is False:
            check_zip(path)
            content: dict[str, Any] = super().load_checkpoint(Path(path), map_location, False)
            return content
        return read_checkpoint(path, map_location)
