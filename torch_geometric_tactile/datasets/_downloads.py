r"""Downloads of published files."""

from collections.abc import Mapping
from pathlib import Path

import pooch
import requests

from torch_geometric_tactile._files import atomic_path, file_sha256


def download_files(url: str, folder: Path, sha256: Mapping[str, str], progress: bool) -> None:
    r"""Downloads those of some files that a folder does not have, each whole or not at all, and
    compares their checksums.
    """
    get = pooch.HTTPDownloader(progressbar=progress, timeout=20)
    for name, published in sha256.items():
        if (folder / name).is_file():
            continue
        try:
            with atomic_path(folder / name) as temporary:
                get(f"{url}/{name}", str(temporary), None)
                found = file_sha256(temporary)
                if found != published:
                    raise ValueError(
                        f"the hash of downloaded file '{name}' must be {published} (got {found}); "
                        f"put the file into '{folder}' by hand"
                    )
        except requests.RequestException as error:
            raise ConnectionError(
                f"'{name}' is not in '{folder}' and could not be downloaded from '{url}'; put the "
                f"file there by hand ({error})"
            ) from error


def verify_file(path: Path, sha256: str) -> None:
    r"""Compares a file with the checksum of the published one."""
    found = file_sha256(path)
    if found != sha256:
        raise ValueError(
            f"'{path}' must have the SHA-256 checksum {sha256} (got {found}); "
            "delete it to download it again, or pass 'checksum=False' to read it as it is"
        )
