"""LeRobot data sets, one file of which is mutated.

A case has files in one folder, so each file of a data set lies there as
``SET__PATH__OF__FILE.part``, and the data set itself beside them.
"""

import io
import json
import shutil
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from fuzz.bytes_mutations import BYTES
from fuzz.laws import JUDGED, REWRITTEN
from fuzz.text_mutations import encoded
from fuzz.tree_mutations import as_json, mutated_tree

SUFFIX = ".part"
EVERY_FRAME = ("every", "policy")
_MANY = 300_000  # rows that a Parquet file holds in a few bytes


def make(folder: Path) -> None:
    """A data set, one with all frames since the last step, one of touch that policies read, with
    actions, one of touch and joint angles in one feature, one of touch in two features, and one in
    the form of 0.2.0.
    """
    from fuzz.bases import commands, small_recording

    from torch_geometric_tactile.io import add_to_lerobot, write_lerobot

    made = [small_recording(label=label, meta={"object": label}) for label in ("mug", "cup")]
    recordings = [
        replace(r, extra={"pac": np.ones((r.num_frames, 2, 2))}, annotations=[(0.0, 0.1, "slip")])
        for r in made
    ]
    write_lerobot(recordings, folder / "plain", fps=50)
    write_lerobot(recordings, folder / "every", fps=20, every_frame=True)
    demonstrations = [replace(r, action=commands()) for r in recordings]
    keys = {"policy": "observation.environment_state", "joined": "observation.state"}
    write_lerobot(
        demonstrations, folder / "policy", 20, key=keys["policy"], every_frame=True, fill=0
    )
    write_lerobot(demonstrations, folder / "joined", 50, key=keys["joined"])
    write_lerobot(made, folder / "left", fps=29.97, key="observation.tactile.left")
    add_to_lerobot(folder / "left", made, folder / "fingers", key="observation.tactile.right")
    write_lerobot(recordings, folder / "old", fps=50, task="pick")
    _as_of_0_2_0(folder / "old")
    for name in ("plain", *EVERY_FRAME, "joined", "fingers", "old"):
        (folder / name / "README.md").unlink()
        for path in (folder / name).rglob("*.*"):
            if "episodes" not in path.parts and path.name != "stats.json":  # are not read
                parts = path.relative_to(folder).parts
                shutil.copyfile(path, folder / f"{'__'.join(parts)}{SUFFIX}")


def _as_of_0_2_0(root: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = root / "data/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    readings = np.reshape(table["observation.tactile"].to_pylist(), (-1, 3, 3)).tolist()
    table = table.set_column(0, "observation.tactile", pa.array(readings))
    pq.write_table(table.replace_schema_metadata(None), path, write_page_checksum=True)
    info = json.loads((root / "meta/info.json").read_text())
    info["features"]["observation.tactile"]["shape"] = [3, 3]
    (root / "meta/info.json").write_text(json.dumps(info))
    own = json.loads((root / "meta/tactile.json").read_text())
    episodes = [{"label": e["label"], "meta": e["meta"]} for e in own["episodes"]]
    (root / "meta/tactile.json").write_text(json.dumps({"version": 1, "episodes": episodes}))


def read(path: Path) -> Any:
    """All recordings of the data set of a part."""
    from fuzz.readers import recording

    from torch_geometric_tactile.io import read_lerobot

    root = path.parent / path.name.split("__")[0]
    if not root.exists():  # the whole files, beside which no data set was kept
        _assemble(path)
    tactile = "observation.tactile.*" if root.name == "fingers" else None
    is_every_frame = root.name in EVERY_FRAME
    return [recording(r) for r in read_lerobot(root, tactile=tactile, every_frame=is_every_frame)]


def mutate(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    """A part with other bytes, another tree or another table, in its data set."""
    allowed = REWRITTEN
    if draw.random() < 0.5:
        path.write_bytes(draw.choice(BYTES)(data, draw, other))
        allowed = JUDGED if path.name.endswith(f".parquet{SUFFIX}") else REWRITTEN
    elif path.name.endswith(f".json{SUFFIX}"):
        path.write_bytes(encoded(as_json(mutated_tree(json.loads(data), draw), draw), draw))
    else:
        path.write_bytes(_other_table(data, draw))
    _assemble(path)
    return allowed


def _assemble(path: Path) -> Path:
    name = path.name.split("__")[0]
    for part in path.parent.glob(f"{name}__*{SUFFIX}"):
        target = path.parent.joinpath(*part.name.removesuffix(SUFFIX).split("__"))
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(part, target)
    return path.parent / name


def _other_table(data: bytes, draw: Random) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(io.BytesIO(data))
    index = draw.randrange(table.num_columns)
    name, rows = table.column_names[index], table.num_rows
    kind = draw.randrange(6)
    if kind == 0:  # rows that are repeated, far too often or in another order
        often = draw.choice([2, 1000, _MANY])
        table = table.slice(0, 1).take(np.zeros(often, dtype=np.int32))
    elif kind == 1:
        table = table.take(draw.choices(range(rows), k=rows))
    elif kind == 2:
        table = table.drop_columns([name])
    elif kind == 3:
        values: list[Any] = [
            None,
            0.5,
            -1,
            2**62,
            "a",
            b"a",
            "a" * 2**20,
            [1.0] * 9,
            [[1.0]],
            {"a": 1},
        ]
        table = table.set_column(index, name, pa.array([draw.choice(values)] * rows))
    elif kind == 4:
        values = [[0.0] * draw.choice([0, 1, 2**20])] + [[0.0] * 9] * (rows - 1)
        table = table.set_column(index, name, pa.array(values))
    else:
        table = table.append_column(draw.choice([name, "note"]), table.column(index))
    file = io.BytesIO()
    settings = {"compression": draw.choice(["zstd", "snappy", "none"])}
    pq.write_table(table, file, write_page_checksum=draw.random() < 0.5, **settings)
    return file.getvalue()
