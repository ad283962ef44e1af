import os
from pathlib import Path

import pytest
from robustness import full_disk

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that are forked"),
]


@pytest.fixture(scope="module")
def disk(tmp_path_factory):
    folder = tmp_path_factory.mktemp("disk")
    try:
        with full_disk.small_disk(Path(folder)) as small:
            yield small
    except PermissionError as error:
        pytest.skip(f"{error}: only root may")


@pytest.mark.parametrize("name", ["append_hdf5", "write_hdf5", "processed file"])
def test_full_disk_ends_in_a_clear_error_and_keeps_what_was_there(name, disk):
    writer = next((w for w in full_disk.writers() if w.name == name), None)
    if writer is None:
        pytest.skip("needs the extra 'io'")
    ended, wrong = full_disk.check_writer(writer, disk, sizes=3)
    assert wrong == []
    assert ended == {"OSError": 2, "written": 1}
