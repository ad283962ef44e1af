import struct
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="needs the extra 'lerobot'")

import pyarrow as pa
import pyarrow.parquet as pq

from torch_geometric_tactile.io._lerobot_tables import _check_columns, check_pages

ROWS = 1_000_000


def chunks(path):
    group = pq.ParquetFile(path).metadata.row_group(0)
    return [group.column(j) for j in range(group.num_columns)]


@pytest.mark.parametrize("compression", ["none", "snappy", "zstd"])
@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("dictionary", [False, True])
def test_pages_of_whole_files_hold_what_is_declared(tmp_path, compression, version, dictionary):
    table = pa.table(
        {
            "a": np.arange(5000),
            "b": [[1.0, None, 3.0], None] * 2500,
            "c": ["text", None, "more"] * 1666 + ["", "x"],
            "d": [True, False] * 2500,
        }
    )
    path = tmp_path / "a.parquet"
    pq.write_table(
        table,
        path,
        compression=compression,
        data_page_version=version,
        use_dictionary=dictionary,
        data_page_size=1000,
        write_page_checksum=True,
    )
    check_pages(path, chunks(path))


def unsigned(number, length=0):
    """Bytes of seven bits; a longer form of the same number if asked for."""
    out = []
    while number or len(out) < length or not out:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out[:-1], out[-1] & 127])


def test_a_footer_that_declares_less_is_refused(tmp_path):
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"a": np.zeros(ROWS, dtype=np.int64)}), path, row_group_size=ROWS)
    content = path.read_bytes()
    (length,) = struct.unpack("<I", content[-8:-4])
    footer = content[-8 - length : -8]
    large = unsigned(2 * ROWS)
    assert footer.count(large) > 1
    footer = footer.replace(large, unsigned(2 * 5, len(large)))
    path.write_bytes(content[: -8 - length] + footer + content[-8:])
    assert chunks(path)[0].num_values == 5
    with pytest.raises(ValueError, match=f"must hold 5 values in .* as its footer .*got {ROWS} in"):
        check_pages(path, chunks(path))


@pytest.mark.parametrize(
    ("place", "data", "match"),
    [
        (4, b"\0", "must have sizes .got a header without"),
        (4, b"\x1b", "must have headers of Parquet .got a field of 11"),
        (4, b"\x15" + b"\xff" * 10 + b"\1", "got a number that is too long"),
        (4, b"\x18" + unsigned(2**40), "must have complete headers .got the end"),
        (20, None, "must end at the position that its footer"),
    ],
)
def test_damaged_headers_are_refused(tmp_path, place, data, match):
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"a": np.arange(50)}), path)
    content, declared = path.read_bytes(), chunks(path)
    rest = b"" if data is None else content[place + len(data) :]
    path.write_bytes(content[:place] + (data or b"") + rest)
    with pytest.raises(ValueError, match=match):
        check_pages(path, declared)


def field(number, kind, content):
    """A field of a header, by its number."""
    return bytes([kind, 2 * number]) + content


NUMBERS = b"".join(field(number, 5, b"\0") for number in (1, 2, 3))  # a page of no bytes
COUNTED = field(5, 12, field(1, 5, unsigned(2 * 7)) + b"\0")


@pytest.mark.parametrize(
    ("fields", "num_values"),
    [
        (NUMBERS + COUNTED, 7),
        (NUMBERS, 0),
        (NUMBERS + field(5, 12, b"\0"), 0),
        (NUMBERS + field(20, 1, b"") + COUNTED, 7),
        (NUMBERS + field(20, 2, b"") + COUNTED, 7),
        (NUMBERS + field(20, 3, b"\7") + COUNTED, 7),
        (NUMBERS + field(20, 7, b"\7" * 8) + COUNTED, 7),
        (NUMBERS + field(20, 8, b"\3abc") + COUNTED, 7),
    ],
    ids=["counted", "no count", "empty count", "true", "false", "byte", "double", "text"],
)
def test_values_of_a_page_are_counted_by_its_header(tmp_path, fields, num_values):
    """Fields that a newer version may add are passed over."""
    path = tmp_path / "a.parquet"
    path.write_bytes(b"PAR1" + fields + b"\0")
    size = {"total_compressed_size": len(fields) + 1, "total_uncompressed_size": 0}
    place = {"data_page_offset": 4, "dictionary_page_offset": None}
    check_pages(path, [SimpleNamespace(num_values=num_values, **place, **size)])
    with pytest.raises(ValueError, match=f"got {num_values} in 0"):
        check_pages(path, [SimpleNamespace(num_values=8, **place, **size)])


@pytest.mark.parametrize(("levels", "is_right"), [((1, 0), True), ((2, 0), False), ((0, 0), False)])
def test_columns_whose_statistics_are_of_another_kind_are_refused(tmp_path, levels, is_right):
    # pyarrow's description of such a column ends the process.
    pytest.importorskip("pyarrow", "20", reason="writes the statistics that are checked")
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"a": pa.array([1, None, 3]), "b": [[1], None, []]}), path)
    _check_columns(path, pq.read_metadata(path))
    column = SimpleNamespace(
        path="a", max_definition_level=levels[0], max_repetition_level=levels[1]
    )
    schema = SimpleNamespace(column=lambda j: column)
    metadata = SimpleNamespace(schema=schema, num_columns=1)
    if is_right:
        _check_columns(path, metadata)
    else:
        with pytest.raises(ValueError, match="its column 'a' must have statistics of its type"):
            _check_columns(path, metadata)
