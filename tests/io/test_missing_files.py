"""Every reader says of a file that is missing what to do about it."""

import re

import pytest

from torch_geometric_tactile import io

ADVICE = {
    io.read_bigs: "give the path of an HDF5 or npz file",
    io.read_biotac_slide_csv: "put the file of BioTac_slide_20_50 there",
    io.read_biotac_sp_csv: "put the file of the BioTac SP stability set there",
    io.read_biotac_sp_dos_csv: "put the file of BioTac SP DoS there",
    io.read_hdf5: "give the path of a recording",
    io.read_icub_grasp_txt: "put the file of the iCub Grasp data set there",
    io.read_idx: "give the path of an IDX file",
    io.read_matrix_csv: "give the path of a CSV file",
    io.read_matrix_mat: "give the path of a MAT file",
    io.read_matrix_npy: "give the path of an npy file",
    io.read_matrix_png: "give the path of a PNG file",
    io.read_mcap: "give the path of a recording",
    io.read_named_csv: "give the path of a recording",
    io.read_npz: "give the path of a recording",
    io.read_recording: "give the path of a recording",
    io.read_samples_npz: "give the path of an npz file",
    io.read_wide_csv: "give the path of a recording",
    io.read_xela_log_csv: "give the path of a recording",
    io.read_xela_messages: "give the path of a recording",
}


@pytest.mark.parametrize("read", ADVICE, ids=lambda read: read.__name__)
def test_missing_files_and_folders(tmp_path, read):
    if read is io.read_hdf5:
        pytest.importorskip("h5py", reason="needs the extra 'io'")
    for path in (tmp_path, tmp_path / "gone.npz"):
        text = re.escape(f"'{path}' does not exist; {ADVICE[read]}")
        with pytest.raises(FileNotFoundError, match=f"^{text}$"):
            read(path)
