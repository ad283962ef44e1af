r"""Statistics of LeRobot data sets, without the readings that are missing."""

import json
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Stats = dict[str, np.ndarray]


def feature_stats(values: np.ndarray) -> Stats:
    r"""Returns the statistics of one feature in one episode.

    Each value of a step has its own. Those of frames since the last step are pooled over their
    rows. A value without any reading has zeros.

    Shapes:
        - **values:** The values :math:`(T,)`, :math:`(T, D)` or :math:`(T, R, D)`.
    """
    rows = values.reshape(len(values), -1) if values.ndim == 1 else values
    rows = rows.reshape(-1, rows.shape[-1]).astype(np.float64)
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # of a channel without readings
        out = {
            "min": np.nanmin(rows, axis=0),
            "max": np.nanmax(rows, axis=0),
            "mean": np.nanmean(rows, axis=0),
            "std": np.nanstd(rows, axis=0),
        }
        quantiles = np.nanquantile(rows, [*QUANTILES.values()], axis=0)
    out |= dict(zip(QUANTILES, quantiles, strict=True))
    times = values[0].size // rows.shape[1]
    out = {name: np.tile(np.nan_to_num(value, nan=0.0), times) for name, value in out.items()}
    return {**out, "count": np.array([len(values)])}


def joined_stats(episodes: Sequence[Mapping[str, Stats]]) -> dict[str, Stats]:
    r"""Returns the statistics of a data set from those of its episodes, as LeRobot joins them: by
    the numbers of frames; quantiles are averages.
    """
    out = {}
    for name in episodes[0]:
        parts = [episode[name] for episode in episodes]
        counts = np.array([float(part["count"][0]) for part in parts])
        share = (counts / counts.sum())[:, None]
        mean = (share * [part["mean"] for part in parts]).sum(axis=0)
        spread = [part["std"] ** 2 + (part["mean"] - mean) ** 2 for part in parts]
        out[name] = {
            "min": np.min([part["min"] for part in parts], axis=0),
            "max": np.max([part["max"] for part in parts], axis=0),
            "mean": mean,
            "std": np.sqrt((share * spread).sum(axis=0)),
            **{q: (share * [part[q] for part in parts]).sum(axis=0) for q in QUANTILES},
            "count": np.array([int(counts.sum())]),
        }
    return out


def stats_json(stats: Mapping[str, Stats]) -> str:
    r"""Returns statistics as LeRobot's :obj:`meta/stats.json`."""
    content: dict[str, Any] = {
        name: {key: value.tolist() for key, value in part.items()} for name, part in stats.items()
    }
    return json.dumps(content, indent=4, allow_nan=False)
