import pytest

from torch_geometric_tactile._limits import ARRAY_BYTES, EXPANSION, is_absurd


@pytest.mark.parametrize(
    ("size", "file_size", "absurd"),
    [
        (ARRAY_BYTES, 1, False),
        (ARRAY_BYTES + 1, 1, True),
        (ARRAY_BYTES + 1, ARRAY_BYTES // EXPANSION + 1, False),
        (EXPANSION * ARRAY_BYTES, ARRAY_BYTES, False),
        (EXPANSION * ARRAY_BYTES + 1, ARRAY_BYTES, True),
    ],
)
def test_a_file_is_absurd_if_large_and_far_larger_than_its_bytes(size, file_size, absurd):
    assert is_absurd(size, file_size, ARRAY_BYTES) is absurd


def test_other_formats_may_be_packed_less():
    assert is_absurd(300, 2, limit=100, expansion=100)
    assert not is_absurd(300, 3, limit=100, expansion=100)
