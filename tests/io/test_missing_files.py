"""Every reader says of a file that is missing what to do about it."""

import re

import pytest

from torch_geometric_tactile import io
from torch_geometric_tactile.io._biotac_sp_csv import read_biotac_sp_csv, read_biotac_sp_dos_csv
from torch_geometric_tactile.io._icub_grasp_txt import read_icub_grasp_txt
from torch_geometric_tactile.io._idx_file import read_idx
from torch_geometric_tactile.io._matrix_files import (
    read_matrix_csv,
    read_matrix_npy,
    read_matrix_png,
)
from torch_geometric_tactile.io._matrix_mat import read_matrix_mat
from torch_geometric_tactile.io._named_csv import read_named_csv
from torch_geometric_tactile.io._recording_npz import read_npz
from torch_geometric_tactile.io._wide_csv import read_wide_csv
from torch_geometric_tactile.io._xela_log_csv import read_xela_log_csv
from torch_geometric_tactile.io._xela_messages import read_xela_messages

ADVICE = {
    io.read_bigs: "give the path of an HDF5 or npz file",
    io.read_biotac_slide_csv: "put the file from BioTac_slide_20_50 there",
    read_biotac_sp_csv: "put the file from the BioTac SP stability set there",
    read_biotac_sp_dos_csv: "put the file from BioTac SP DoS there",
    io.read_hdf5: "give the path of a recording",
    read_icub_grasp_txt: "put the file from the iCub Grasp data set there",
    read_idx: "give the path of an IDX file",
    read_matrix_csv: "give the path of a CSV file",
    read_matrix_mat: "give the path of a MAT file",
    read_matrix_npy: "give the path of an npy file",
    read_matrix_png: "give the path of a PNG file",
    io.read_mcap: "give the path of a recording",
    read_named_csv: "give the path of a recording",
    read_npz: "give the path of a recording",
    io.read_recording: "give the path of a recording",
    io.read_samples_npz: "give the path of an npz file",
    read_wide_csv: "give the path of a recording",
    read_xela_log_csv: "give the path of a recording",
    read_xela_messages: "give the path of a recording",
}


@pytest.mark.parametrize("read", ADVICE, ids=lambda read: read.__name__)
def test_missing_files_and_folders(tmp_path, read):
    if read is io.read_hdf5:
        pytest.importorskip("h5py", reason="needs the extra 'io'")
    for path in (tmp_path, tmp_path / "gone.npz"):
        text = re.escape(f"'{path}' does not exist; {ADVICE[read]}")
        with pytest.raises(FileNotFoundError, match=f"^{text}$"):
            read(path)
