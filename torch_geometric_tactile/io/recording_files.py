r"""Reading and writing of recordings in any supported format."""

import inspect
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_format import CSV_OPTIONS, CsvFormat
from torch_geometric_tactile.io._csv_table import csv_rows
from torch_geometric_tactile.io._folder_recordings import is_probe_run
from torch_geometric_tactile.io._mcap_records import MAGIC
from torch_geometric_tactile.io._named_csv import read_named_csv
from torch_geometric_tactile.io._recording_npz import read_npz, write_npz
from torch_geometric_tactile.io._recording_schema import recording_path
from torch_geometric_tactile.io._wide_csv import is_named_csv_header, read_wide_csv, write_wide_csv
from torch_geometric_tactile.io._xela_log_csv import is_xela_log, read_xela_log_csv
from torch_geometric_tactile.io._xela_messages import read_xela_messages, write_xela_messages
from torch_geometric_tactile.io.eflesh_probe import read_eflesh_probe
from torch_geometric_tactile.io.mcap_reader import read_mcap
from torch_geometric_tactile.io.recording_hdf5 import read_hdf5, write_hdf5
from torch_geometric_tactile.io.recording_mcap import write_mcap


class _Format(NamedTuple):
    read: Callable[..., Recording]
    write: Callable[[Recording, PathLike], None] | None = None
    suffixes: tuple[str, ...] = ()
    read_only_suffixes: tuple[str, ...] = ()  # further suffixes, for reading only


_FORMATS = {
    "HDF5": _Format(read_hdf5, write_hdf5, (".h5", ".hdf5")),
    "npz": _Format(read_npz, write_npz, (".npz",)),
    "MCAP": _Format(read_mcap, write_mcap, (".mcap",)),
    "wide CSV": _Format(read_wide_csv, write_wide_csv, (".csv",)),
    "named CSV": _Format(read_named_csv),
    "XELA log CSV": _Format(read_xela_log_csv),
    "XELA messages": _Format(
        read_xela_messages, write_xela_messages, (".jsonl", ".ndjson"), (".json", ".txt")
    ),
    "eFlesh probe": _Format(read_eflesh_probe),
}
_WRITERS = {suffix: format_.write for format_ in _FORMATS.values() for suffix in format_.suffixes}
_SUFFIXES = {s: name for name, f in _FORMATS.items() for s in (*f.suffixes, *f.read_only_suffixes)}
_SIGNATURES = {b"\x89HDF\r\n\x1a\n": "HDF5", b"PK\x03\x04": "npz", MAGIC: "MCAP"}
_NO_OPTIONS = CsvFormat()
_JSON_START = re.compile(rb"(\xef\xbb\xbf)*\s*[\[{]")


def recording_format(path: PathLike, csv_format: CsvFormat = _NO_OPTIONS) -> str:
    r"""Returns the name of a file's format: :obj:`"HDF5"`, :obj:`"npz"`, :obj:`"MCAP"`,
    :obj:`"wide CSV"`, :obj:`"named CSV"`, :obj:`"XELA log CSV"` or :obj:`"XELA messages"`, or
    :obj:`"eFlesh probe"` for a folder with a run of eFlesh's probe.

    The suffix must be known. The beginning of the file takes precedence over a wrong suffix, and
    distinguishes the CSV formats by their headers:

    * A XELA log has a column name that only such logs have.
    * A wide CSV has a name that :func:`write_wide_csv` writes, the number of columns of the papers'
      hand data, or no header.
    * Any other CSV file with a header is a named CSV.

    Args:
        path (str or PathLike): The file.
        csv_format (CsvFormat): The text format of a CSV file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the suffix is unknown.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "grasp.csv"
        ...     _ = path.write_text("time,thumb,index\n0,5,1\n")
        ...     recording_format(path)
        'named CSV'
    """
    if is_probe_run(Path(path)):
        return "eFlesh probe"
    path = recording_path(path)
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise ValueError(f"'{path}' must end in one of {', '.join(_SUFFIXES)} (got '{suffix}')")
    with path.open("rb") as file:
        first_bytes = file.read(4096)
    for signature, name in _SIGNATURES.items():
        if first_bytes.startswith(signature):
            return name
    header = [] if _JSON_START.match(first_bytes) else _first_row(path, csv_format)
    if is_xela_log(header):
        return "XELA log CSV"
    if _SUFFIXES[suffix] == "wide CSV" and is_named_csv_header(header):
        return "named CSV"
    return _SUFFIXES[suffix]


def _first_row(path: Path, csv_format: CsvFormat) -> list[str]:
    try:
        return next(csv_rows(path, csv_format), (0, []))[1]
    except ValueError:  # the reader reports it
        return []


def read_recording(path: PathLike, **kwargs: Any) -> Recording:
    r"""Reads a recording from a file of any supported format (see :func:`recording_format`).

    Args:
        path (str or PathLike): The file, or the folder of a run of eFlesh's probe.
        **kwargs: Options of the reader of the format, such as :obj:`forces` for XELA's formats. For
            CSV files these are :obj:`tactile`, :obj:`num_channels`, :obj:`joint`, :obj:`time`,
            :obj:`time_unit`, :obj:`label`, :obj:`extra`, :obj:`ignore`, :obj:`unit` and
            :obj:`rate` for the columns, :obj:`num_taxels`, :obj:`num_joints` and :obj:`header` for
            files without names, and :obj:`separator`, :obj:`decimal`, :obj:`encoding`,
            :obj:`preamble`, :obj:`unit_row`, :obj:`time_format` and :obj:`missing` for the text.
            With :obj:`num_frames`, only the first frames are read.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If the format needs an extra that is missing.
        ValueError: If the suffix is unknown, the format has no such option, or the file cannot be
            read.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "grasp.csv"
        ...     _ = path.write_text("time,thumb,index\n0,5,1\n0.01,7,2\n")
        ...     read_recording(path, unit="count")
        Recording(num_frames=2, num_taxels=2, num_channels=1, rate=100)
    """
    name, options = _reader_options(path, kwargs)
    return _FORMATS[name].read(path, **options)


def _reader_options(path: PathLike, options: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    # The format of a file and the arguments of its reader.
    name = select_format(path, options)
    supported = format_options(name)
    for key in options:
        if key not in supported:
            valid_options = ", ".join(supported) or "none"
            raise ValueError(
                f"'{key}' must be an option of the format {name}: {valid_options} ('{path}')"
            )
    arguments = {key: value for key, value in options.items() if key not in CSV_OPTIONS}
    if len(arguments) < len(options):
        arguments["csv_format"] = _csv_format(options)
    return name, arguments


def _csv_format(options: Mapping[str, Any]) -> CsvFormat:
    return CsvFormat(**{key: options[key] for key in CSV_OPTIONS if key in options})


def select_format(path: PathLike, options: Mapping[str, Any]) -> str:
    r"""Returns the format in which a file is read with the given options. The options select
    between the CSV formats.
    """
    name, option_names = recording_format(path, _csv_format(options)), {*options}
    if not name.endswith("CSV"):
        return name
    if name != "XELA log CSV" and option_names & {"num_taxels", "num_joints", "header"}:
        return "wide CSV"
    named_csv_options = {*format_options("named CSV")} - {*format_options("wide CSV")}
    return "named CSV" if named_csv_options & option_names else name


def format_options(name: str) -> list[str]:
    r"""Returns the names of the options with which :func:`read_recording` reads a format.

    Examples:
        >>> format_options("XELA messages")
        ['forces']
    """
    names = [*inspect.signature(_FORMATS[name].read).parameters][1:]
    options = [option for option in names if option != "csv_format"]
    return [*options, *CSV_OPTIONS] if "csv_format" in names else options


def write_recording(recording: Recording, path: PathLike) -> None:
    r"""Writes a recording in the format of the suffix: ``.h5`` or ``.hdf5``, ``.npz``, ``.mcap``,
    ``.csv`` (one frame per row), ``.jsonl`` or ``.ndjson`` (XELA messages). A warning lists any
    content that the format cannot store.

    Args:
        recording (Recording): The recording.
        path (str or PathLike): The file, which is either complete or absent.

    Raises:
        ImportError: If the format needs an extra that is missing.
        ValueError: If the suffix is unknown, or the format cannot store the readings.

    Examples:
        >>> import tempfile
        >>> import numpy as np
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.ones((2, 4, 3)))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_recording(recording, f"{folder}/grasp.npz")
        ...     read_recording(f"{folder}/grasp.npz")
        Recording(num_frames=2, num_taxels=4, num_channels=3, rate=100)
    """
    suffix = Path(path).suffix.lower()
    write = _WRITERS.get(suffix)
    if write is None:
        raise ValueError(f"'{path}' must end in one of {', '.join(_WRITERS)} (got '{suffix}')")
    write(recording, path)
