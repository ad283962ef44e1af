r"""Base classes of data sets that are read from files: folders, download and change detection."""

import hashlib
import logging
import os
from collections.abc import Mapping
from pathlib import Path

import pooch
import requests

from torch_geometric_tactile._files import atomic_path, file_sha256
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.datasets._root import default_root

_logger = logging.getLogger(__name__)
_END_BYTES = 1 << 16  # hashed at each end of a file
_LONG_READING_BYTES = 20_000_000  # total size above which reading takes seconds


class RawFiles(StaticDataset):
    r"""A data set that is read from files. A subclass defines :obj:`raw_file_names`, the names of
    its default folder and its processed file, and the error message for missing files.
    """

    force_reload: bool
    _folder: str | None = None  # name of the default root
    _processed_name: str

    def __init__(
        self,
        root: PathLike | None,
        transform: Transform | None,
        pre_transform: Transform | None,
        pre_filter: Filter | None,
        force_reload: bool,
    ) -> None:
        if root is None and self._folder is not None:
            root = default_root(self._folder)
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    @property
    def raw_paths(self) -> list[str]:
        r"""The paths of the raw files."""
        folder = Path(self.raw_dir)  # computed once, since it may list folders
        return [str(folder / name) for name in self.raw_file_names]

    @property
    def processed_file_names(self) -> str:
        r"""The processed file of all selections."""
        return self._processed_name

    def raw_state(self) -> list[str]:
        r"""Returns a text for each raw file that changes with the content of the file (see
        :func:`file_state`).
        """
        folder = Path(self.raw_dir)
        files = [name for name in self._state_names() if (folder / name).is_file()]
        return [f"{name}={file_state(folder / name)}" for name in files]

    def _state_names(self) -> list[str]:
        # The files whose changes make the processed file outdated.
        return list(self.raw_file_names)

    def _process(self) -> None:
        is_processed = Path(self.processed_paths[0]).is_file() and not self.force_reload
        if not is_processed:
            self._need_files()
            self._log_long_reading()
        super()._process()

    def _log_long_reading(self) -> None:
        paths = [Path(path) for path in self.raw_paths]
        size = sum(path.stat().st_size for path in paths if path.is_file())
        if size >= _LONG_READING_BYTES:
            _logger.info(
                "reading %s (%.0f MB) of '%s' for the first time; later runs read '%s'",
                "1 file" if len(paths) == 1 else f"{len(paths)} files",
                size / 1e6,
                self.raw_dir,
                self.processed_paths[0],
            )

    def _need_files(self) -> None:
        # Raises an error if there are no files to process.
        if not self.raw_file_names:
            raise FileNotFoundError(self._no_files())

    def _no_files(self) -> str:
        # The error message for missing files.
        raise NotImplementedError

    @property
    def num_classes(self) -> int:
        r"""The number of classes or labels of the data set. A selection may lack some of them."""
        return len(self.class_names)


class PublishedFiles(RawFiles):
    r"""A data set whose files are downloaded and verified by their checksums. A subclass sets
    :obj:`checksum`.
    """

    url: str
    checksum: bool
    _sha256: Mapping[str, str]

    @property
    def raw_dir(self) -> str:
        r"""The folder of the files: :obj:`root` if it has all of them, else :obj:`root/raw`."""
        is_in_root = all(Path(self.root, name).is_file() for name in self._sha256)
        return str(self.root if is_in_root else Path(self.root, "raw"))

    @property
    def raw_file_names(self) -> list[str]:
        r"""The published files."""
        return list(self._sha256)

    @property
    def processed_file_names(self) -> str:
        r"""The processed file of all selections. Unverified raw files have a separate one."""
        return f"{self._processed_name}{'' if self.checksum else '_unverified'}.pt"

    def download(self) -> None:
        r"""Downloads missing files and verifies their checksums.

        Raises:
            ConnectionError: If a file cannot be downloaded.
            ValueError: If a downloaded file does not have the published checksum.
        """
        get = pooch.HTTPDownloader(progressbar=self.log, timeout=20)
        folder = Path(self.raw_dir)
        for name, published in self._sha256.items():
            if (folder / name).is_file():
                continue
            try:
                with atomic_path(folder / name) as temporary:
                    get(f"{self.url}/{self._path_at_url(name)}", str(temporary), None)
                    checksum = self._hash(temporary)
                    if checksum != published:
                        raise ValueError(
                            f"the hash of downloaded file '{name}' must be {published} (got "
                            f"{checksum}); put the file into '{folder}' by hand"
                        )
            except requests.RequestException as error:
                raise ConnectionError(
                    f"'{name}' is not in '{folder}' and could not be downloaded from "
                    f"'{self.url}'; put the file there by hand ({error})"
                ) from error

    def _path_at_url(self, name: str) -> str:
        return name

    def _hash(self, path: PathLike) -> str:
        # A subclass whose archive is generated at each download hashes a part of it.
        return file_sha256(path)

    def _verify(self) -> None:
        # Compares the files with the published checksums, unless checksum=False.
        for path in self.raw_paths if self.checksum else ():
            published, checksum = self._sha256[Path(path).name], self._hash(path)
            if checksum != published:
                raise ValueError(
                    f"'{path}' must have the SHA-256 checksum {published} (got {checksum}); "
                    "delete it to download it again, or pass 'checksum=False' to read it as it is"
                )


def file_state(path: PathLike) -> str:
    r"""Returns a text that changes with the content of a file: its size, a hash of its first and
    last 64 KiB and, for files above 128 KiB, the time of the last change. The cost does not depend
    on the size of the file.

    A short file that was copied or touched keeps its state. A long file that was copied or touched
    counts as changed, since changes in its middle can only be detected by the time.
    """
    with Path(path).open("rb") as file:
        stat = os.fstat(file.fileno())
        digest = hashlib.blake2b(file.read(_END_BYTES), digest_size=16)
        if stat.st_size > _END_BYTES:
            file.seek(max(_END_BYTES, stat.st_size - _END_BYTES))
            digest.update(file.read(_END_BYTES))
    time = f",{stat.st_mtime_ns}" if stat.st_size > 2 * _END_BYTES else ""
    return f"{stat.st_size},{digest.hexdigest()}{time}"
