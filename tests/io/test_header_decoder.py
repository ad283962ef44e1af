import pytest

from torch_geometric_tactile.io.decoders._header_decoder import SequenceNumbers

LONG_AGO = 2**32 + 65_535 - 2**20 - 1


@pytest.mark.parametrize(
    ("numbers", "found"),
    [
        ([5, 6, 8], [(5, 0), (6, 0), (8, 1)]),
        ([2**32 - 1, 0, 2], [(2**32 - 1, 0), (2**32, 0), (2**32 + 2, 1)]),
        ([2**32 - 2, 1], [(2**32 - 2, 0), (2**32 + 1, 2)]),
        ([100, 0, 1, 1], [(100, 0), (101, 0), (102, 0), (103, 0)]),
        ([2**31 + 5, 3], [(2**31 + 5, 0), (2**31 + 6, 0)]),
        ([3 * 10**9, 70_000], [(3 * 10**9, 0), (2**32 + 70_000, 2**32 + 69_999 - 3 * 10**9)]),
        ([7, 2**31 + 7], [(7, 0), (2**31 + 7, 2**31 - 1)]),
        ([7, 2**31 + 8], [(7, 0), (8, 0)]),
        # A loss of up to 2^20, or to a number from 2^16 on; otherwise the device has started over.
        ([LONG_AGO, 65_535], [(LONG_AGO, 0), (2**32 + 65_535, 2**20)]),
        ([LONG_AGO, 65_536], [(LONG_AGO, 0), (2**32 + 65_536, 2**20 + 1)]),
        ([LONG_AGO - 1, 65_535], [(LONG_AGO - 1, 0), (LONG_AGO, 0)]),
    ],
)
def test_unwraps_by_hand(numbers, found):
    unwrap = SequenceNumbers()
    assert [unwrap.unwrap(number) for number in numbers] == found
