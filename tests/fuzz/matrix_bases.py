"""Small whole files of matrices, which the mutations start from."""

import gzip
import struct
from pathlib import Path

import numpy as np

SIZE = (4, 3)


def _stack(count: int = 2) -> np.ndarray:
    return np.random.default_rng(0).normal(40, 10, (count, *SIZE)).round(2)


def csv(folder: Path) -> None:
    matrix = _stack()[0]
    np.savetxt(folder / "a.csv", matrix, delimiter=",", fmt="%.2f")
    lines = [",".join(str(cell) for cell in row) for row in matrix.tolist()]
    lines[1] = f"{matrix[1, 0]},,7"
    (folder / "b.csv").write_text("\n".join(lines) + "\n")


def npy(folder: Path) -> None:
    np.save(folder / "a.npy", _stack().astype(np.float32))
    np.save(folder / "b.npy", np.asfortranarray(_stack()[0].astype(np.uint16)))


def png(folder: Path) -> None:
    from PIL import Image

    grey = np.random.default_rng(0).integers(0, 256, (32, 32)).astype(np.uint8)
    Image.fromarray(grey).save(folder / "a.png")


def mat(folder: Path) -> None:
    from scipy.io import savemat

    also = {"note": "a press", "cells": {"a": 1.0, "b": "deep"}}
    savemat(folder / "a.mat", {**also, "press": _stack()}, do_compression=True)
    savemat(folder / "b.mat", {"press": _stack().astype(np.uint8), **also})


def mat_variables(folder: Path) -> None:
    from published_files import cell
    from scipy.io import savemat

    content = {"press": _stack().astype(np.uint16), "valid": np.array([[True, False]])}
    content["names"] = cell("mug", "tür é", "")
    savemat(folder / "a.mat", {**content, "also": {"a": 1.0}}, do_compression=True)
    savemat(folder / "b.mat", {**content, "names": cell("one", "two").T, "also": "text"})


def idx(folder: Path) -> None:
    numbers = np.random.default_rng(0).integers(0, 256, (5, *SIZE)).astype(np.uint8)
    data = b"\0\0\x08\x03" + struct.pack(">3I", *numbers.shape) + numbers.tobytes()
    (folder / "a.gz").write_bytes(gzip.compress(data, mtime=0))


def eflesh_sequence(folder: Path) -> None:
    import torch

    torch.save(torch.arange(90.0).view(3, 30), folder / "a.pt")
    torch.save(torch.arange(60.0).view(2, 30) / 7, folder / "b.pt")


def mat_zip(folder: Path) -> None:
    from mat_files import mat_files, write_mat

    files = {name: data for name, data in mat_files().items() if "-ii/S1/" in name}
    write_mat(folder / "a.zip", dict(list(files.items())[:4]))
    write_mat(folder / "b.zip", dict(list(files.items())[4:]))
