"""Reference readers of the text formats: short, slow, and without any guess. They return what a
reader must return, or raise ``Refused``."""

import csv
import decimal
import functools
import hashlib
import io
import re
import zipfile
from collections.abc import Sequence
from typing import Any

import numpy as np
from fuzz.laws import Refused
from fuzz.tree_oracles import need, strict_json

AXES = ("x", "y", "z")


def reading(time: Any, tactile: Any, joint: Any = None, label: Any = None, **more: Any) -> Any:
    """A recording as ``readers.recording`` returns it."""
    time = np.asarray(time, dtype=np.float64)
    with np.errstate(over="ignore"):
        tactile = np.asarray(tactile, dtype=np.float32)
        joint = None if joint is None else np.asarray(joint, dtype=np.float32)
        action = more.get("action")
        action = None if action is None else np.asarray(action, dtype=np.float32)
    need(len(time) > 0 and bool(np.isfinite(time).all()) and bool((np.diff(time) > 0).all()))
    need(not any(np.isinf(a).any() for a in (tactile, joint, action) if a is not None))
    meta, privileged = more.get("meta", {}), more.get("privileged", {})
    return {
        "time": time,
        "tactile": tactile,
        "joint": joint,
        "label": label,
        "meta": meta,
        "privileged": privileged,
        "extra": more.get("extra", {}),
        "annotations": [],
        "action": action,
    }


SEPARATORS = ";\t|"


def annotations_csv(data: bytes) -> Any:
    head, rows = table(data, separators=SEPARATORS)
    need({"recording", "start", "end", "label"} <= {*head})
    out: dict[str, Any] = {}
    for row in rows:
        told = dict(zip(head, row, strict=True))
        start, end = (number(told[key].replace(",", ".")) for key in ("start", "end"))
        label = _unmarked(told["label"])
        need(abs(start) < np.inf and abs(end) < np.inf and start <= end)
        need(0 < len(label) < 256 and label.isprintable() and label == label.strip())
        out.setdefault(_unmarked(told["recording"]), []).append([start, end, label])
    return out


def labels_csv(data: bytes) -> Any:
    head, rows = table(data, separators=SEPARATORS)
    need("recording" in head and "" not in head[:1])
    told = [{name: _unmarked(cell) for name, cell in zip(head, row, strict=True)} for row in rows]
    whole = {
        name
        for name in head
        if all(re.fullmatch("[+-]?[0-9]{1,18}", row[name]) for row in told if row[name])
    }
    out: dict[str, Any] = {}
    for row in told:
        name = row.pop("recording")
        need(name not in out)
        out[name] = {key: int(text) if key in whole else text for key, text in row.items() if text}
    return out


def _unmarked(cell: str) -> str:
    text = cell.strip()
    return text[1:] if re.match("'+\\s*[=+@\uff1d\uff0b\uff0d\uff20-]", text) else text


def table(
    data: bytes, named: bool = True, separators: str = ""
) -> tuple[list[str], list[list[str]]]:
    """The header and the other lines of a CSV file, all of one length.

    A header without commas may have one of the separators. Empty cells after the names of a header
    are none.
    """
    try:
        text = data.decode("utf-8-sig")
        first = text.removeprefix("\ufeff").replace("\r", "\n").partition("\n")[0]
        signs = [sign for sign in separators if sign in first and "," not in first]
        rows = list(csv.reader(io.StringIO(text, newline=""), delimiter=(*signs, ",")[0]))
    except (UnicodeDecodeError, csv.Error) as error:
        raise Refused(str(error)) from error
    need(text.endswith(("\n", "\r")) and len(rows) > 1)
    # A line of commas is a frame without readings, and an empty one is none.
    need(all(len(row) > 1 or any(cell.strip() for cell in row) for row in rows))
    width = len(rows[0])
    while width and not rows[0][width - 1].strip():
        width -= 1
    if sum(map(is_text, rows[0][:width])) > width / 2:
        rows = [row[:width] if not "".join(row[width:]).strip() else row for row in rows]
    head = [name.strip() for name in rows[0]]
    need(not named or len(set(head)) == len(head))
    need(all(len(row) == len(head) for row in rows))
    return head, rows[1:]


def is_text(cell: str) -> bool:
    try:
        number(cell)
    except Refused:
        return True
    return not cell.isascii() or "_" in cell


def number(cell: str) -> float:
    """What a cell says; NaN if empty."""
    try:
        return float(cell) if cell.strip() else float("nan")
    except ValueError as error:
        raise Refused(cell) from error


def numbers(rows: Sequence[Sequence[str]]) -> np.ndarray:
    return np.array([[number(cell) for cell in row] for row in rows])


def matrix_csv(data: bytes) -> Any:
    """Four lines of three numbers, without a header."""
    head, rows = table(data, named=False)
    need(len(rows) == 3 and len(head) == 3)
    found = numbers([head, *rows])
    with np.errstate(over="ignore"):
        need(not np.isinf(found.astype(np.float32)).any())
    return found[None]


_TIME = re.compile("(?:time|timestamp|t)(?:_(s|ms|us|ns))?")

_PLACES = {None: 0, "s": 0, "ms": 3, "us": 6, "ns": 9}


def seconds(head: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[str | None, np.ndarray]:
    """The column of the time, if there is one, and the time, rounded once."""
    found = [(name, match) for name in head if (match := _TIME.fullmatch(name.lower()))]
    need(len(found) <= 1)
    if not found:
        return None, np.arange(len(rows)) / 100.0
    name, match = found[0]
    cells = [row[head.index(name)].strip() for row in rows]
    need(not np.isnan([number(cell) for cell in cells]).any())
    try:
        exact = [decimal.Decimal(cell).scaleb(-_PLACES[match[1]]) for cell in cells]
    except decimal.InvalidOperation as error:
        raise Refused(str(error)) from error
    return name, np.array([float(value) for value in exact])


def wide_csv(data: bytes) -> Any:
    """Columns by name; every taxel with every axis."""
    head, rows = table(data, separators=SEPARATORS)
    head = [name.lower() for name in head]
    timed, time = seconds(head, rows)
    place = {name: i for i, name in enumerate(head)}
    taxels = sum(bool(re.fullmatch(r"taxel_[0-9]+_[a-z0-9]+", name)) for name in head)
    joints = sum(name.startswith("joint_") for name in head)
    actions = sum(name.startswith("action_") for name in head)
    for channels in (1, 2, 3, 4):
        axes = AXES[:channels] if channels <= 3 else [str(i) for i in range(channels)]
        names = [f"taxel_{i}_{axis}" for i in range(taxels // channels) for axis in axes]
        names += [f"joint_{i}" for i in range(joints)]
        names += [f"action_{i}" for i in range(actions)]
        if set(names) == set(head) - {timed} and taxels:
            found = numbers([[row[place[name]] for name in names] for row in rows])
            return reading(
                time,
                found[:, :taxels].reshape(len(rows), -1, channels),
                found[:, taxels : taxels + joints] if joints else None,
                action=found[:, taxels + joints :] if actions else None,
            )
    raise Refused("header")


def named_csv(data: bytes, tactile: Any = None, joint: Any = (), label: str | None = None) -> Any:
    """Columns by name; all but the time and the given ones if none are given."""
    head, rows = table(data, separators=SEPARATORS)
    timed, time = seconds(head, rows)
    need(timed is not None)
    used = {timed, *joint, label}
    all_given = tactile is not None
    tactile = [name for name in head if name not in used] if tactile is None else tactile
    need({*tactile, *joint} <= set(head) and (label is None or label in head) and bool(tactile))
    # pandas' names of a table without any, and its index.
    need(
        all_given
        or not any(
            name == "" or re.fullmatch("[0-9]+", name) or name.startswith("Unnamed")
            for name in head
        )
    )

    def columns(names: Any) -> np.ndarray:
        return numbers([[row[head.index(name)] for name in names] for row in rows])

    more: dict[str, Any] = {} if all_given else {"meta": {"column_names": {"tactile": tactile}}}
    if label is not None:
        cells = [row[head.index(label)].strip() for row in rows]
        need(all(cells))
        whole = all(re.fullmatch("[+-]?[0-9]{1,18}", cell) for cell in cells)
        values = np.array([int(cell) for cell in cells]) if whole else np.array(cells)
        if len(set(values.tolist())) == 1:
            more["label"] = values[0].item()
        else:
            more["privileged"] = {label: values}
    found = columns(tactile)
    angles = columns(joint) if joint else None
    return reading(time, found.reshape(len(rows), -1, 1), angles, **more)


def excel_csv(data: bytes) -> Any:
    """A line, then columns by name, with decimal commas, NA and -1."""
    text = data.decode("utf-8-sig", "replace").removeprefix("\ufeff")
    parts = re.split("(\r\n|\r|\n)", text, maxsplit=1)
    need(len(parts) == 3)
    head, rows = table(parts[2].encode(), separators=SEPARATORS)
    need("\ufffd" not in text)
    timed, _ = seconds(head, [])
    lines = [head]
    for row in rows:
        cells = [cell.replace(",", ".") for cell in row]
        lines.append(
            [
                "" if name != timed and _stands_for_none(cell) else cell
                for name, cell in zip(head, cells, strict=True)
            ]
        )
    plain = io.StringIO()
    csv.writer(plain).writerows(lines)
    return named_csv(plain.getvalue().encode())


def _stands_for_none(cell: str) -> bool:
    return cell.strip() == "NA" or (not is_text(cell) and number(cell) == -1)


def xela_log(data: bytes, forces: bool = False) -> Any:
    """Rows that repeat the one before are counted and left out."""
    head, rows = table(data, separators=SEPARATORS)
    head = [" ".join(name.lower().replace("_", " ").split()) for name in head]
    need("send time" in head and "message number" in head and len(set(head)) == len(head))
    known = [
        bool(re.fullmatch(r"(force )?\d+[xyz]|(send|receive) time|message number", n)) for n in head
    ]
    found = numbers([[c if k else "" for c, k in zip(row, known, strict=True)] for row in rows])
    time, count = head.index("send time"), head.index("message number")
    own, other = (
        _xela_columns(head, "force " if forces else ""),
        _xela_columns(head, "" if forces else "force "),
    )
    need(bool(own))
    kept: list[np.ndarray] = []
    for row in found:
        need(not np.isnan(row[[time, count]]).any())
        if kept:
            before = kept[-1]
            both = own + other
            same = np.array_equal(row[both], before[both], equal_nan=True)
            if row[time] == before[time] or row[count] == before[count] or same:
                continue
        kept.append(row)
    meta = {
        "sensor": "XELA uSkin",
        "unit": "newton" if forces else "count",
        "stale_rows": len(found) - len(kept),
    }
    readings = np.array([row[own] for row in kept]).reshape(len(kept), -1, 3)
    return reading([row[time] for row in kept], readings, meta=meta)


def _xela_columns(head: list[str], start: str) -> list[int]:
    names = [name for name in head if re.fullmatch(start + "[0-9]+[xyz]", name)]
    wanted = [f"{start}{i + 1}{axis}" for i in range(len(names) // 3) for axis in AXES]
    # Nothing that looks like a reading is left out.
    need(set(names) == set(wanted))
    return [head.index(name) for name in wanted]


def biotac_csv(data: bytes) -> Any:
    fingers = ("ff", "mf", "th")
    names = [f"{finger}_biotac_{i}" for finger in fingers for i in range(1, 25)]
    head, rows = table(data)
    need({"object", "slipped", *names} <= set(head))
    found = numbers([[row[head.index(name)] for name in ["slipped", *names]] for row in rows])
    need(bool(np.isfinite(found).all()) and bool(np.isin(found[:, 0], (0, 1)).all()))
    values = found[:, 1:].reshape(-1, 3, 24).transpose(0, 2, 1)
    objects = [row[head.index("object")].strip() for row in rows]
    return [values.astype(np.float32), found[:, 0].astype(np.int64), objects]


def dos_csv(data: bytes) -> Any:
    names = [f"{finger}_e{i}" for finger in ("ff", "mf", "th") for i in range(1, 25)]
    head, rows = table(data)
    need({*head} in ({*names[:24]}, {*names}))
    found = numbers(rows)
    with np.errstate(over="ignore"):
        need(bool(np.isfinite(found.astype(np.float32)).all()))
    own = found[:, [head.index(name) for name in names[:24]]]
    meta = {"sensor": "biotac_sp", "unit": "count", "rate": 100.0}
    return reading(np.arange(len(rows)) / 100, own[:, :, None], meta=meta)


def mat_zip(data: bytes) -> Any:
    """Files of 64 lines with 27 whole numbers, by person, mattress and posture."""
    form = r"(?:.*?/)?experiment-ii/S(\d{1,3})/(Air|Sponge)_Mat/Matrix_\2_([A-Z])(\d{1,3})\.txt"
    found = []
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for entry in archive.infolist():
                name = re.fullmatch(form, entry.filename, re.ASCII)
                if name:
                    lines = re.split(rb"[\r\n]+", archive.read(entry))
                    need(all(re.fullmatch(rb"[0-9 \t]*", line) for line in lines))
                    rows = [list(map(int, line.split())) for line in lines if line.strip()]
                    need(len(rows) == 64 and all(len(row) == 27 for row in rows))
                    need(max(map(max, rows)) < 2**31)
                    found.append((name, np.array([rows], dtype=np.float32)))
    except Refused:
        raise
    except Exception as error:
        raise Refused(str(error)) from error
    need(bool(found))
    need(len({item[0][0].partition("experiment-ii/")[2] for item in found}) == len(found))
    found.sort(key=lambda item: (int(item[0][1]), item[0][2], item[0][3], int(item[0][4])))
    return [[f"S{n[1]}", n[3] + n[4], n[2].lower(), x] for n, x in found]


def mat_zip_hash(data: bytes) -> Any:
    """The hash of the list of checksums, if all that is listed is there, and nothing else."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = [name.partition("/")[2] for name in archive.namelist()]
            files = dict(zip(names, map(archive.read, archive.infolist()), strict=True))
    except Exception as error:
        raise Refused(str(error)) from error
    need(len(files) == len(names) and "SHA256SUMS.txt" in files)
    sums = files.pop("SHA256SUMS.txt")
    codes = [f"{hashlib.sha256(text).hexdigest()} {name}" for name, text in files.items()]
    need(sorted(codes) == sorted(sums.decode("latin-1").splitlines()))
    return hashlib.sha256(sums).hexdigest()


def slide_csv(data: bytes) -> Any:
    """A table of 45 columns, whose lines may end with a comma."""
    try:
        lines = data.decode("utf-8-sig").splitlines(keepends=True)
    except UnicodeDecodeError as error:
        raise Refused(str(error)) from error
    width = len(next(csv.reader(lines[:1]), ()))
    cut = []
    for line in lines:
        row = next(csv.reader([line]), [])
        has_more = len(row) == width + 1 and not row[-1].strip()
        cut.append(re.sub(r",[^,]*?(\r?\n|\r)?$", r"\1", line) if has_more else line)
    head, rows = table("".join(cut).encode())
    signals = ["tdc", "tac", "pdc"]
    arrays = {"pac": [f"pac{i}" for i in range(1, 23)], "ele": [f"ele{i}" for i in range(1, 20)]}
    names = ["timestamp", *signals, *arrays["pac"], *arrays["ele"]]
    need({*names} <= set(head))
    found = numbers([[row[head.index(name)] for name in names] for row in rows])
    with np.errstate(over="ignore"):
        need(bool(np.isfinite(found.astype(np.float32)).all()))
    values = found.astype(np.float32)
    extra = {"pac": values[:, 4:26], **{name: values[:, i + 1] for i, name in enumerate(signals)}}
    meta = {"sensor": "biotac", "unit": "count"}
    return {**reading(found[:, 0], values[:, 26:, None], meta=meta), "extra": extra}


def icub_txt(data: bytes) -> Any:
    """Seven lines a frame, with 9, 5 and five times 12 numbers."""
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError as error:
        raise Refused(str(error)) from error
    need(text.endswith("\n") and not re.search(r"[^ -~\t\n\r]|\r(?!\n)", text))
    lines = [line.split() for line in text.split("\n")[:-1]]
    need([number(cell) for cell in lines[0]] == [-10000.0])
    frames = [lines[i : i + 7] for i in range(1, len(lines), 7)]
    need(len(frames) > 0 and all(list(map(len, f)) == [9, 5] + 5 * [12] for f in frames))
    need(not any("_" in cell for line in lines for cell in line))
    cells = [numbers(frame) for i in range(7) for frame in [[f[i] for f in frames]]]
    encoder, maximum, reading = cells[0], cells[1], np.concatenate(cells[2:], axis=1)
    for values in (maximum, reading):
        need(bool(np.isin(values, np.arange(256)).all()))
    need(bool((np.abs(encoder) <= 360).all()))
    lowest = np.stack([part.min(axis=1) for part in cells[2:]], axis=1)
    need(bool((np.abs(255 - lowest - maximum) <= 6).all()))
    return [v.astype(np.float32) for v in (reading, np.deg2rad(encoder), maximum)]


def eflesh_probe(sensor: bytes, states: bytes) -> Any:
    """Rows of numbers that pair, without a header; a force of -1 is none."""
    tables = [table(data, named=False) for data in (sensor, states)]
    readings, probe = (numbers([head, *rows]) for head, rows in tables)
    need(not np.isnan(readings).any() and not np.isnan(probe).any())
    need(len(readings) == len(probe) and probe.shape[1] == 5)
    need(readings.shape[1] % 3 == 1 and readings.shape[1] > 1)
    time = readings[:, 0]
    frame = np.median(np.diff(time)) if len(time) > 1 else np.inf
    need(bool((np.abs(time - probe[:, 0]) < frame).all()))
    force = np.where(probe[:, 4] == -1, np.nan, probe[:, 4])
    return reading(
        time,
        readings[:, 1:].reshape(len(time), -1, 3),
        meta={"sensor": "eflesh", "trial": ""},
        extra={"force": force, "probe": probe[:, 1:4]},
    )


_LEFT = re.compile(r'}|"\s*:')


def xela_messages(data: bytes) -> Any:
    """One message a line; other lines are those of a log, without what is left of a message."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise Refused(str(error)) from error
    frames: list[dict[str, Any]] = []
    repeated = skipped = 0
    for line in text.splitlines():
        if "{" not in line:
            need(not _LEFT.search(line))
            continue
        before, brace, rest = line.partition("{")
        after = rest[rest.rfind("}") + 1 :]
        need(not _LEFT.search(before) and not _LEFT.search(after) and "{" not in after)
        message = strict_json(brace + rest[: rest.rfind("}") + 1])
        if isinstance(message, dict) and isinstance(message.get("message"), str):
            skipped += any(key.isdecimal() for key in message)
            continue
        frame = xela_frame(message)
        if frames and frame["number"] == frames[-1]["number"]:
            repeated += 1
            continue
        need(not frames or all(frame[k] == frames[-1][k] for k in ("taxels", "models")))
        frames.append(frame)
    need(bool(frames))
    first = frames[0]
    meta = {
        "sensor": "XELA uSkin",
        "unit": "count",
        "models": first["models"],
        "taxels": first["taxels"],
        "handedness": first["handedness"],
        "handedness_reliable": False,
        "server_version": first["version"],
        "repeated_messages": repeated,
        "skipped_messages": skipped,
    }
    return reading(
        [frame["time"] for frame in frames], [frame["counts"] for frame in frames], meta=meta
    )


def xela_frame(message: Any) -> dict[str, Any]:
    need(isinstance(message, dict) and type(message.get("message")) is int)
    time = message.get("time", message.get("sendtime"))
    need(type(time) in (int, float))
    keys = sorted((key for key in message if key.isdecimal()), key=int)
    need(bool(keys) and message.get("sensors", len(keys)) == len(keys))
    counts: list[int] = []
    taxels: list[int] = []
    for key in keys:
        sensor = message[key]
        need(isinstance(sensor, dict) and isinstance(sensor.get("data"), str))
        need(
            str(sensor.get("sensor", key)).isdecimal()
            and int(sensor.get("sensor", key)) == int(key)
        )
        words = [word for word in re.split(r"[,\s]+", sensor["data"]) if word]
        need(bool(words) and all(re.fullmatch("[0-9A-Fa-f]{1,4}", word) for word in words))
        own = [int(word, 16) for word in words]
        stated = sensor.get("taxels", len(own) // 3)
        need(type(stated) is int and len(own) == 3 * stated)
        need(sensor.get("integer", own) == own)
        counts += own
        taxels.append(len(own) // 3)
    return {
        "number": message["message"],
        "time": float(time),
        "counts": np.array(counts).reshape(-1, 3),
        "taxels": taxels,
        "models": [str(message[key].get("model", "")) for key in keys],
        "handedness": [str(message[key].get("handedness", "")) for key in keys],
        "version": str(message.get("version", "")),
    }


def is_part_of_mcap(mutated: bytes, found: Any) -> bool:
    """Whether a damaged recording was told of, and has only frames of a whole one."""
    frames = _whole_mcap_frames()
    return found["told"] and all(
        found["tactile"][i].tobytes() in frames for i in range(len(found["time"]))
    )


@functools.cache
def _whole_mcap_frames() -> set[bytes]:
    from fuzz import bases

    recordings = (bases.full_recording(), bases.small_recording())
    return {frame.tobytes() for recording in recordings for frame in recording.tactile}
