"""Small whole files of readings, which the mutations start from."""

import json
from pathlib import Path

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.sensors import grid

FRAMES = 6

TIME = np.arange(FRAMES) / 128  # whole nanoseconds, and exact as text


def small_recording(joints: int = 2, **more: object) -> Recording:
    draw = np.random.default_rng(0)
    tactile = draw.normal(0, 100, (FRAMES, 3, 3)).round(2).astype(np.float32)
    tactile[1, 2, 0] = np.nan
    joint = draw.normal(size=(FRAMES, joints)).round(3) if joints else None
    return Recording(time=TIME, tactile=tactile, joint=joint, **more)


def commands() -> np.ndarray:
    return np.arange(FRAMES * 2, dtype=np.float32).reshape(FRAMES, 2) / 4


def full_recording() -> Recording:
    return small_recording(
        label="mug é",
        meta={"unit": "newton", "object": "mug", "taxels": [2, 1], "tare": None, "rate": 128.0},
        privileged={
            "phase": np.arange(FRAMES) // 3,
            "force": np.arange(12.0).reshape(FRAMES, 2),
            "name": np.array(["reach", "hold"] * 3),
        },
        extra={"pac": np.arange(FRAMES * 6, dtype=np.int16).reshape(FRAMES, 3, 2)},
        annotations=[(0, 1 / 64, "slip é"), (1 / 64, 1 / 32, "hold"), (0, 1 / 32, "hold")],
        action=commands(),
    )


def annotations_csv(folder: Path) -> None:
    lines = ["recording,start,end,label", "a,0,0.5,slip", "b.csv,-1,1e3,'=hold", 'a,3,3,"x, y"']
    (folder / "a.csv").write_text("\n".join(lines) + "\n")


def labels_csv(folder: Path) -> None:
    lines = ["recording,label,object,trial,mass", "a,slip,mug,1,0.5", "b.csv,,'=cup,2,", "c,3,,3,1"]
    (folder / "a.csv").write_text("\n".join(lines) + "\n")


def wide_csv(folder: Path) -> None:
    from torch_geometric_tactile.io._wide_csv import write_wide_csv

    write_wide_csv(small_recording(action=commands()), folder / "a.csv")
    write_wide_csv(small_recording(joints=0), folder / "b.csv")


def named_csv(folder: Path) -> None:
    lines = [
        "time,thumb,index,palm",
        *(f"{t!r},{i}.5,{10 * i},7" for i, t in enumerate(TIME.tolist())),
    ]
    (folder / "a.csv").write_text("\n".join(lines) + "\n")


def excel_csv(folder: Path) -> None:
    lines = [f"{t!r};{i}.5;NA;-1" for i, t in enumerate(TIME.tolist())]
    text = "\n".join(["Glove 7, day 2", "time;thumb;index;palm", *lines, ""])
    (folder / "a.csv").write_text(text.replace(".", ","))


def given_names_csv(folder: Path) -> None:
    head = "timestamp,cup,thumb,index,palm,wrist"
    lines = [f"{t!r},{i % 2},{i}.25,,{3 * i},0.{i}" for i, t in enumerate(TIME.tolist())]
    (folder / "a.csv").write_text("\n".join([head, *lines]) + "\n")
    lines = [f"{t!r},mug,{i}.25,1,{3 * i},0.{i}" for i, t in enumerate(TIME.tolist())]
    (folder / "b.csv").write_text("\n".join([head, *lines]) + "\n")


def xela_log(folder: Path, forces: bool = True) -> None:
    head = "Receive time,Send time,Message number," + ",".join(
        f"{taxel}{axis}" for taxel in (1, 2) for axis in "XYZ"
    )
    if forces:
        head += "," + ",".join(f"Force {taxel}{axis}" for taxel in (1, 2) for axis in "XYZ")
    lines = [head]
    for i, number in enumerate([0, 1, 1, 2, 3, 4]):
        counts = [30000 + 7 * number + k for k in range(6)]
        newtons = [f"{0.125 * number + k:.3f}" for k in range(6)] if forces else []
        cells = [1.5e9 + 0.01 * i, 1.5e9 + 0.0078125 * i, 70 + i, *counts, *newtons]
        lines.append(",".join(map(str, cells)))
    (folder / "a.csv").write_text("\n".join(lines) + "\n")


def xela_log_both(folder: Path) -> None:
    xela_log(folder, forces=False)
    (folder / "a.csv").rename(folder / "b.csv")
    xela_log(folder)


def xela_messages(folder: Path) -> None:
    from torch_geometric_tactile.io._xela_message import format_xela_message

    lines = ['{"message": "Welcome"}', "connected to the server"]
    for i in range(4):
        counts = np.arange(9).reshape(3, 3) * 1000 + i
        message = format_xela_message(
            counts, i + 5, 1.5e9 + i / 128, taxels=[1, 2], models=["XR1944", "XR2244"]
        )
        lines.append(json.dumps(message))
    (folder / "a.jsonl").write_text("\n".join(lines) + "\n")


def xela_live(folder: Path) -> None:
    from torch_geometric_tactile.io._xela_message import format_xela_message

    counts = np.arange(9).reshape(3, 3) * 7000 + 5
    message = format_xela_message(counts, 7, 1.5e9, taxels=[2, 1])
    message["1"].update(temp=[306.5, None], ups=[2.5, 3])
    message["2"].update(temp=[300.25], ups=[4])
    (folder / "a.json").write_text(json.dumps(message))
    message["1"]["data"] = message["1"]["data"].replace(",", ",\n")
    message["2"]["data"] = message["2"]["data"].replace(",", ",\n")
    del message["1"]["integer"], message["2"]["integer"]
    (folder / "b.json").write_text(json.dumps(message).replace("\\n", "\n"))


def biotac_csv(folder: Path) -> None:
    names = [f"{finger}_biotac_{i}" for finger in ("ff", "mf", "th") for i in range(1, 25)]
    lines = [",".join(["object", "slipped", *names])]
    for row in range(3):
        lines.append(
            ",".join(
                [f"cup {row % 2}", str(row % 2), *(str(1000 + row * 72 + i) for i in range(72))]
            )
        )
    (folder / "a.csv").write_text("\n".join(lines) + "\n")


def dos_csv(folder: Path) -> None:
    names = [f"{finger}_e{i}" for finger in ("ff", "mf", "th") for i in range(1, 25)]
    for file, own in (("a.csv", names[:24]), ("b.csv", names)):
        lines = [",".join(own)]
        lines += [",".join(str(3000 + 31 * t + i) for i in range(len(own))) for t in range(4)]
        (folder / file).write_text("\n".join(lines) + "\n")


def slide_csv(folder: Path) -> None:
    from published_files import slide

    slide(folder / "a.csv", frames=3)
    text = slide(folder / "b.csv", frames=2, start=0.5).read_text()
    (folder / "b.csv").write_text(text.replace(",\n", "\n"))


def uskin_pick(folder: Path) -> None:
    from published_files import uskin_trial

    uskin_trial(folder, frames=3, notes='"loose grip, high slip"')
    for name in ("marker.csv", "meta_data.csv.npy"):  # are not read
        (folder / name).unlink()


def sparsh_skin(folder: Path) -> None:
    from published_files import pickled, sparsh_joints, sparsh_touch

    for protocol in (4, 5):
        pickled(folder / f"touch{protocol}.pkl", sparsh_touch(2), protocol)
        pickled(folder / f"joints{protocol}.pkl", {"joint_states": sparsh_joints(3)}, protocol)


def _bigs_fields(frames: int = 3) -> dict[str, np.ndarray]:
    draw = np.random.default_rng(0)
    return {
        "elec": draw.integers(0, 4096, (frames, 57)).astype(np.int16),
        "stamp": 10 * np.arange(frames),
        "left": draw.normal(size=frames),
        "middle": draw.normal(size=frames),
        "right": draw.normal(size=frames).astype(np.float32),
        "pac": draw.integers(0, 4096, (22 * frames, 3)).astype(np.int16),
        "arm": draw.normal(size=(3 * frames, 2)).astype(np.float32),
        "step": np.array(["close", "lift é", "lift é"][:frames]),
        "slipped": np.arange(frames) > 1,
        "done": np.array(1),
        "what": np.array("cup é"),
        "lift": np.array(10.0),
    }


def bigs_npz(folder: Path) -> None:
    np.savez(folder / "a.npz", **_bigs_fields())
    np.savez_compressed(folder / "b.npz", **{**_bigs_fields(2), "done": np.array("failure")})


def bigs_hdf5(folder: Path) -> None:
    import h5py

    for name, frames in (("a.h5", 3), ("b.h5", 2)):
        with h5py.File(folder / name, "w", libver=("v110", "v110")) as file:
            for key, value in _bigs_fields(frames).items():
                if value.dtype.kind == "U":
                    value, form = value.astype(object), h5py.string_dtype()
                else:
                    form = value.dtype
                is_plain = value.ndim and value.dtype != object
                packed = {"compression": "gzip", "fletcher32": True} if is_plain else {}
                file.create_dataset(key, data=value, dtype=form, **packed)


def icub_txt(folder: Path) -> None:
    lines = ["-10000"]
    for frame in range(4):
        rows = [[240 - (7 * i + 5 * k + frame) % 19 for k in range(12)] for i in range(5)]
        lines.append(" ".join(f"{10.5 * i + frame:g}" for i in range(9)) + " ")
        lines.append(" ".join(f"{255 - min(row)}.0" for row in rows))
        lines += [" ".join(f"{cell}.0" for cell in row) for row in rows]
    (folder / "cup_1.txt").write_bytes("".join(f"{line}\r\n" for line in lines).encode())


EFLESH = (  # sensor.csv, states.csv
    b"".join(b"%d.5,%d,-7.25,9e3,1,2,%d\n" % (i, i % 3, 5 * i) for i in range(6)),
    b"".join(b"%d.625,315.0,-100.0,%d.25,%d\n" % (i, i, (i % 2) * 41 - 1) for i in range(6)),
)


def eflesh_probe(folder: Path) -> None:
    for name, text in zip(("sensor.csv", "states.csv"), EFLESH, strict=True):
        (folder / name).write_bytes(text)


def npz(folder: Path) -> None:
    from torch_geometric_tactile.io._recording_npz import write_npz

    write_npz(full_recording(), folder / "a.npz")
    write_npz(small_recording(joints=0), folder / "b.npz")


def samples_npz(folder: Path) -> None:
    draw = np.random.default_rng(0)
    x = draw.normal(size=(6, 2, 3, 2)).astype(np.float32)
    x[1, 0, 1] = np.nan
    names = np.array(["mug", "cup é", "mug"] * 2)
    columns = {"trial": np.arange(6) // 2, "joint": draw.normal(size=(6, 2)), "time": TIME}
    np.savez(folder / "a.npz", x=x, y=names, session=names, set=names, **columns)
    taxels = {"pos": grid(2, 3, 0.01).pos.numpy(), "edge_index": np.array([[0, 1], [1, 0]])}
    np.savez_compressed(folder / "b.npz", x=x.reshape(6, 6, 2), y=np.arange(6) % 2, **taxels)


def hdf5(folder: Path) -> None:
    from torch_geometric_tactile.io import write_hdf5

    write_hdf5(full_recording(), folder / "a.h5")
    write_hdf5(small_recording(joints=0), folder / "b.h5")


def hdf5_appended(folder: Path) -> None:
    """A file that version 0.2 appended to, and a file of today."""
    from torch_geometric_tactile.io import write_hdf5

    old = Path(__file__).parents[1] / "io" / "files" / "appended_0_2.h5"
    (folder / "a.h5").write_bytes(old.read_bytes())
    write_hdf5(small_recording(joints=0), folder / "b.h5")


def mcap(folder: Path) -> None:
    from torch_geometric_tactile.data import LiveFrame
    from torch_geometric_tactile.io import McapWriter, write_mcap

    write_mcap(full_recording(), folder / "a.mcap")
    whole = small_recording()
    with McapWriter(
        folder / "b.mcap", meta={"unit": "count"}, anchor=(10**18, 5 * 10**9), label="mug"
    ) as writer:
        for i, time in enumerate(whole.time.tolist()):
            extra = {"temp": np.full(3, i, dtype=np.int16)}
            joint = whole.joint[i] if i % 2 else None
            writer.write_frame(
                LiveFrame(i + 3, 5 + time, i, i / 128, whole.tactile[i], joint, extra)
            )
            writer.write_points(5 + time, np.zeros((3, 3)), {"pressure": np.ones(3)}, "palm")
            if i % 2:  # several chunks
                writer.write_health(5 + time, {"state": "open", "rate": 128.0})
                writer.write_event(5 + time, "mark", "by key")
                writer.flush()
