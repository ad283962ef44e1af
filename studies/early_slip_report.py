r"""Writes the page, the numbers and the picture of early slip from the finished runs.

Examples:
    PYTHONPATH=benchmarks python studies/early_slip_report.py --runs runs
"""

import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
from early_slip import PROTOCOLS, WITHIN
from early_slip_alarms import SlipScores, alarm_threshold, lead_times, slip_summary
from early_slip_pictures import AlarmCurves, plot_early_slip
from scipy.stats import t
from shared import parse, table, write_json

from torch_geometric_tactile.visualization import save_figure

FALSE_ALARMS = 0.02
SECONDS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.75, 1.0, 1.5, 2.0)
_NAMES = {
    "temporal": "TemporalTaxelNet",
    "lstm": "LSTM, 128 cells",
    "force": "shear / normal force, estimated from the electrodes",
    "true-force": "shear / normal force of the simulator",
    "pressure": "weak grip (low fluid pressure)",
}
_EQUAL = (0.1, 0.3, 0.5, 1.0)  # seconds before the onset, each with a threshold of its own


def read(runs: Path) -> dict[str, dict[str, list[tuple[SlipScores, SlipScores, int, int]]]]:
    """Returns validation and test scores, the number of windows trained on and the fold, by
    protocol and method, split by split."""
    found: dict[str, dict[str, list[tuple[SlipScores, SlipScores, int, int]]]] = defaultdict(
        lambda: defaultdict(list)
    )
    for protocol in PROTOCOLS:
        for method in _NAMES:
            for path in sorted(runs.glob(f"{method}_{protocol.replace(' ', '-')}_*.npz")):
                with np.load(path) as file:
                    val, test = (
                        SlipScores(*(file[f"{part}_{key}"] for key in _KEYS))
                        for part in ("val", "test")
                    )
                    fold = int(path.stem.rpartition("_")[2])
                    found[protocol][method].append((val, test, int(file["num_train"]), fold))
    return found


_KEYS = ("score", "to_slip", "moment", "trial")


def numbers(runs: Path) -> dict[str, dict[str, dict[str, list[float]]]]:
    """Returns what is shown, seed by seed."""
    out: dict[str, dict[str, dict[str, list[float]]]] = {}
    for protocol, methods in read(runs).items():
        for method, scores in methods.items():
            row: dict[str, list[float]] = defaultdict(list)
            for val, test, num_train, fold in scores:
                equal = [
                    lead_times(test, alarm_threshold(val, FALSE_ALARMS, before), [before])
                    for before in _EQUAL
                ]
                row["equal_recall"].append([float(times.recall[0]) for times in equal])
                row["equal_false_alarms"].append([float(times.false_alarms[0]) for times in equal])
                threshold = alarm_threshold(val, FALSE_ALARMS)
                times = lead_times(test, threshold, SECONDS)
                row["recall"].append(times.recall.tolist())
                row["false_alarms"].append(times.false_alarms.tolist())
                row["num_slips"].append(times.num_slips.tolist())
                row["num_train"].append(num_train)
                row["fold"].append(fold)
                row["overlap"].append(len(test.trial) / num_train)
                row["num_grasps"].append(len(np.unique(test.trial)))
                for key, value in slip_summary(test, threshold, WITHIN)._asdict().items():
                    row[key].append(value)
            out.setdefault(protocol, {})[method] = dict(row)
    return out


def alarm_table(rows: dict[str, dict[str, list[float]]]) -> list[str]:
    """Returns the lines of a table in Markdown: alarms by the time before the onset."""
    at = [SECONDS.index(seconds) for seconds in (0.1, 0.3, 0.5, 1.0)]
    head = [
        "method",
        *(f"alarm {SECONDS[i]:g} s before" for i in at),
        "false, same moments (0.3 s)",
    ]
    lines = []
    for method, row in rows.items():
        recall = 100 * np.array(row["recall"])
        false_alarms = 100 * np.array(row["false_alarms"])[:, at[1]]
        cells = [*(_spread(recall[:, i]) for i in at), _spread(false_alarms)]
        lines.append([_NAMES[method], *cells])
    return table(head, lines)


def summary_table(rows: dict[str, dict[str, list[float]]]) -> list[str]:
    """Returns the lines of a table in Markdown: slips announced, their lead, and the ROC."""
    head = ["method", f"announced within {WITHIN:g} s", "median lead"]
    head += ["moments of holding grasps with an alarm", "ROC"]
    lines = [
        [
            _NAMES[method],
            _spread(100 * np.array(row["announced"])),
            f"{np.nanmean(row['median_lead']):.2f} s",
            _spread(100 * np.array(row["moments_alarmed"])),
            _spread(np.array(row["roc_auc"]), 3),
        ]
        for method, row in rows.items()
    ]
    return table(head, lines)


def equal_table(rows: dict[str, dict[str, list[float]]]) -> list[str]:
    """Returns the alarms where each time before the onset has the threshold with which the same
    part of holding validation grasps have an alarm at the same moments; in brackets that of the
    test."""
    lines = []
    for method, row in rows.items():
        recall, false = (100 * np.array(row[f"equal_{key}"]) for key in ("recall", "false_alarms"))
        cells = [f"{_spread(recall[:, i])} ({_spread(false[:, i])})" for i in range(len(_EQUAL))]
        lines.append([_NAMES[method], *cells])
    return table(["method", *(f"{before:g} s before" for before in _EQUAL)], lines)


def difference_table(rows: dict[str, dict[str, list[float]]]) -> list[str]:
    """Returns the first method less others by the one rule for noise, over the splits: alarms as in
    the table before, in points, and the ROC. Seeds of one object left out are one split."""
    lines, ours = [], rows["temporal"]
    for other in ("lstm", "pressure", "force"):
        cells = []
        for i in range(len(_EQUAL)):
            recall = (100 * np.array(row["equal_recall"])[:, i] for row in (ours, rows[other]))
            cells.append(_verdict(ours, np.subtract(*recall), 1))
        roc = np.array(ours["roc_auc"]) - np.array(rows[other]["roc_auc"])
        lines.append([_NAMES[other], *cells, _verdict(ours, roc, 3)])
    head = (f"{before:g} s before" for before in _EQUAL)
    return table(["TemporalTaxelNet minus", *head, "ROC"], lines)


def _verdict(row: dict[str, list[float]], gains: np.ndarray, digits: int) -> str:
    folds = np.array(row["fold"])
    if len(set(folds)) > 1:
        gains = np.array([gains[folds == fold].mean() for fold in sorted(set(folds))])
    error = gains.std(ddof=1) * np.sqrt(1 / len(gains) + np.mean(row["overlap"]))
    is_beyond = abs(gains.mean()) > t.ppf(0.975, len(gains) - 1) * error
    told = f"{gains.mean():+.{digits}f} ± {error:.{digits}f}"
    return f"**{told}**" if is_beyond else told


def _spread(values: np.ndarray, digits: int = 1) -> str:
    if len(values) < 2:
        return f"{values.mean():.{digits}f}"
    return f"{values.mean():.{digits}f} ± {values.std(ddof=1):.{digits}f}"


def main() -> int:
    """Writes the tables, the numbers and the pictures."""
    arguments = parse(
        __doc__,
        {
            "--runs": (..., "folder of early_slip.py"),
            "--json": (Path("docs/results/early_slip.json"), "where numbers are written"),
            "--images": (Path("docs/images"), "where pictures are written"),
        },
    )
    found = numbers(Path(arguments.runs))
    if not found:
        print(f"no runs in '{arguments.runs}'", file=sys.stderr)
        return 1
    content = {"seconds": SECONDS, "threshold_false_alarms": FALSE_ALARMS, "protocols": found}
    write_json(arguments.json, content)
    for protocol, rows in found.items():
        print(f"\n{protocol}\n")
        for lines in (
            alarm_table(rows),
            summary_table(rows),
            equal_table(rows),
            difference_table(rows),
        ):
            print("\n".join([*lines, ""]))
        curves = {
            _NAMES[name]: AlarmCurves(np.array(row["recall"]), np.array(row["false_alarms"]))
            for name, row in rows.items()
        }
        title = (
            f"Simulated grasps, {protocol}: alarms in {FALSE_ALARMS:.0%} of the moments of "
            "validation grasps that hold"
        )
        name = f"early_slip_{protocol.replace(' ', '_')}.png"
        save_figure(plot_early_slip(SECONDS, curves, title), arguments.images / name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
