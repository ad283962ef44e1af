"""Checksums of the files that PyTorch writes."""

import copy
import zipfile

import pytest
import torch

from torch_geometric_tactile._files import check_zip


def test_file_of_torch(tmp_path):
    torch.save({"weight": torch.arange(3.0)}, tmp_path / "a.pt")
    check_zip(tmp_path / "a.pt")


def test_every_flipped_bit_is_noticed_or_harmless(tmp_path):
    expected = torch.arange(3.0)
    torch.save(expected, tmp_path / "a.pt")
    content = (tmp_path / "a.pt").read_bytes()
    refused = 0
    for place in range(len(content)):
        for bit in (0, 4):  # 4: that of a folder in the attributes of an entry
            flipped = bytearray(content)
            flipped[place] ^= 1 << bit
            (tmp_path / "b.pt").write_bytes(flipped)
            try:
                check_zip(tmp_path / "b.pt")
                found = torch.load(tmp_path / "b.pt", weights_only=True)
            except (ValueError, RuntimeError):
                refused += 1
            else:
                assert found.equal(expected), place
    assert refused > len(content) / 4  # the rest is padding, dates and the like


@pytest.mark.parametrize("kept", [0, 10, -10])
def test_cut_file(tmp_path, kept):
    torch.save(torch.zeros(3), tmp_path / "a.pt")
    (tmp_path / "a.pt").write_bytes((tmp_path / "a.pt").read_bytes()[:kept])
    with pytest.raises(ValueError, match=r"a\.pt' is damaged or truncated"):
        check_zip(tmp_path / "a.pt")


def test_compressed_entries_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb", bytes(10**6))
    with pytest.raises(ValueError, match="its part 'bomb' is not an uncompressed file"):
        check_zip(tmp_path / "a.zip")


def test_entries_that_share_bytes_are_refused(tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a", bytes(1000))
        for name in "bc":  # whose entries in the table of contents lead to the bytes of the first
            entry = copy.copy(archive.infolist()[0])
            entry.filename = entry.orig_filename = name
            archive.filelist.append(entry)
    with pytest.raises(ValueError, match=r"its parts have 3000 bytes in total, more than the file"):
        check_zip(path)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        check_zip(tmp_path / "a.pt")
