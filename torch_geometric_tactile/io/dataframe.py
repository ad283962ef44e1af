r"""Recordings from pandas tables."""

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io.recording_files import read_recording

if TYPE_CHECKING:
    from pandas import DataFrame


def dataframe_to_recording(frame: "DataFrame", **kwargs: Any) -> Recording:
    r"""Converts a table with one frame per row to a recording.

    Columns have the same roles as in a CSV file: a column named :obj:`time` is the time, and all
    columns without another role are readings. An index of dates or time differences becomes the
    time. Missing values become missing readings.

    Args:
        frame (pandas.DataFrame): The table.
        **kwargs: Options of :func:`~torch_geometric_tactile.io.read_recording` for CSV files, such
            as :obj:`tactile`, :obj:`joint`, :obj:`label`, :obj:`unit` and :obj:`rate`.

    Raises:
        ValueError: If the table is not a recording. The message counts lines as in a CSV file of
            the table: line 2 is the first row.

    Examples:
        >>> import pandas as pd
        >>> frame = pd.DataFrame({"time": [0.0, 0.01], "thumb": [5, 7], "index": [1, 2]})
        >>> dataframe_to_recording(frame, unit="count")
        Recording(num_frames=2, num_taxels=2, num_channels=1, rate=100)
    """
    table = frame
    if frame.index.inferred_type in ("datetime64", "timedelta64"):
        table = frame.reset_index(names="time")
    for name in table.select_dtypes("timedelta"):
        table = table.assign(**{str(name): table[name].dt.total_seconds()})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "DataFrame.csv")
        table.to_csv(path, index=False)
        try:
            return read_recording(path, **kwargs)
        except ValueError as error:
            raise ValueError(str(error).replace(f"'{path}'", "the DataFrame")) from error
