import struct

import numpy as np
from viewer_pages import unpack

from torch_geometric_tactile.live._viewer.message import pack_message


def test_arrays_come_back_and_begin_at_a_multiple_of_four():
    sent = {"tactile": np.array([[1, np.nan, -2.5]]), "pose": np.arange(24).reshape(2, 12)}
    for kind in ("a", "ab", "abc", "abcd", "ä"):
        message = pack_message({"kind": kind}, sent)
        head, arrays = unpack(message)
        assert head["kind"] == kind
        assert struct.unpack_from("<I", message)[0] % 4 == 0
        np.testing.assert_array_equal(arrays["tactile"], sent["tactile"])
        np.testing.assert_array_equal(arrays["pose"], sent["pose"])


def test_numbers_that_browsers_do_not_parse_are_null():
    head, _ = unpack(
        pack_message(
            {
                "age": float("nan"),
                "health": {"rate": np.float32("inf"), "lost": np.int64(3)},
                "all": [1.5, (-np.inf,)],
            }
        )
    )
    assert head["age"] is None
    assert head["health"] == {"rate": None, "lost": 3}
    assert head["all"] == [1.5, [None]]
