r"""Checkpoint files that are written atomically and read without executing code."""

from pathlib import Path
from typing import Any

from lightning.fabric.plugins import TorchCheckpointIO

from torch_geometric_tactile._files import check_zip
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._torch_file import write_torch_file
from torch_geometric_tactile.training._checkpoint_file import read_checkpoint


class AtomicCheckpointIO(TorchCheckpointIO):
    r"""A checkpoint plugin that writes atomically: if the process is killed while writing, the
    previous checkpoint stays unchanged. Reading verifies the checksums and loads only plain data,
    unless :obj:`weights_only=False`.

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
            checkpoint (dict): The content of the checkpoint.
            path (str or PathLike): The file.
            storage_options (optional): Not supported.
        """
        # TorchCheckpointIO would write to a temporary file in another folder. This file would stay
        # there if the process is killed.
        write_torch_file(checkpoint, path)

    def load_checkpoint(
        self, path: PathLike, map_location: Any | None = None, weights_only: bool | None = None
    ) -> dict[str, Any]:
        r"""Reads a checkpoint.

        Args:
            path (str or PathLike): The file.
            map_location (optional): Device of the tensors. Defaults to the device from which they
                were saved.
            weights_only (bool, optional): If :obj:`False`, unpickles objects, which executes code
                from the file.

        Raises:
            FileNotFoundError: If the file does not exist.
            ValueError: If the file is damaged or is not a checkpoint.
        """
        if weights_only is False:
            check_zip(path)
            content: dict[str, Any] = super().load_checkpoint(Path(path), map_location, False)
            return content
        return read_checkpoint(path, map_location)
