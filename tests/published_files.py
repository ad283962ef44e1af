"""Small files in the forms of published data sets, written from their documentation."""

import pickle

import numpy as np

USKIN_READINGS = [f"txl{taxel}_{axis}" for taxel in range(1, 17) for axis in "xyz"]
USKIN_STATE = [f"position_panda_joint{i}" for i in range(1, 8)] + ["position_panda_finger"]
USKIN_STATE += [f"velocity_panda_joint{i}" for i in range(1, 8)]
USKIN_STATE += [f"ee_state_position_{axis}" for axis in "xyz"]
USKIN_STATE += [f"ee_state_orientation_{axis}" for axis in "xyzw"]
SLIDE_COLUMNS = ["timestamp", "tdc", "tac", "pdc", *(f"pac{i}" for i in range(1, 23))]
SLIDE_COLUMNS += [f"ele{i}" for i in range(1, 20)]
LETTERS = ("Space", *"ABCDEFGHIJKLMNOPQRSTUVWXYZ")


def write_csv(path, header, rows, last=""):
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [",".join(header), *(",".join(map(str, row)) + last for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def uskin_readings(frames, start=0, every=4):
    """Counts that change with each `every`-th frame only, as those of a slow sensor."""
    changes = np.arange(frames) // every
    return 16000.0 + start + 100 * np.arange(48) + changes[:, None]


def uskin_trial(folder, frames=8, obj="7", dropped=0, seen=1, rate=40.0, notes=None, longer=0):
    """A trial; training folders have no notes in their metadata, test folders do."""
    for i, extra in ((1, 0), (2, longer)):
        rows = uskin_readings(frames + extra, 20000 * (i - 1))
        write_csv(folder / f"xela_sensor{i}.csv", USKIN_READINGS, rows)
    state = 0.01 * np.arange(22) + 0.001 * np.arange(frames)[:, None]
    write_csv(folder / "robot_state.csv", USKIN_STATE, state.round(6))
    write_csv(folder / "marker.csv", ["x"], [["nan"]])
    (folder / "meta_data.csv.npy").write_bytes(b"\x93NUMPY, and no array")
    names = ["object_name", "object_class", "seen", "dropped"]
    row = [obj, "box", seen, dropped]
    if notes is not None:
        names, row = [*names, "notes"], [*row, notes]
    names += ["sensor_type", "frequency_hz", "start_time", "stop_time"]
    times = ["2021-11-25 13:07:15.514804", "2021-11-25 13:07:20.159157"]
    write_csv(folder / "meta_data.csv", names, [[*row, "xela_2fingers_noglove", rate, *times]])
    return folder


def sparsh_touch(frames=6, base=30000.0, rate=100.0, start=0.0):
    """Frames (368, 4): seconds, and counts that tell taxel, axis and frame."""
    counts = base + 10 * np.arange(368)[:, None] + np.arange(3)
    time = start + np.arange(frames) / rate
    return [np.column_stack([np.full(368, t), counts + i]) for i, t in enumerate(time)]


def sparsh_joints(frames=8, rate=80.0, start=-0.01):
    """Joint states (T', 33): seconds, angles and efforts that are linear in time."""
    time = start + np.arange(frames) / rate
    return np.column_stack([time, time[:, None] + 0.01 * np.arange(32)])


def sparsh_episode(folder, touch=None, joints=None, protocol=4):
    """An episode of Sparsh-skin."""
    touch = sparsh_touch() if touch is None else touch
    pickled(folder / "xela" / "data.pkl", touch, protocol)
    states = {"joint_states": sparsh_joints() if joints is None else joints}
    pickled(folder / "allegro" / "data.pkl", states, protocol)
    return folder


def sparsh_skin(folder, objects=("cup", "corn"), episodes=4, frames=30, base=30000.0):
    """Objects with numbered episodes, and the hand at rest."""
    for i, name in enumerate(objects):
        for number in range(episodes):
            touch = sparsh_touch(frames, base + 100 * i)
            sparsh_episode(folder / name / str(number), touch, sparsh_joints(frames))
    pickled(folder / "baseline" / "xela" / "data.pkl", sparsh_touch(3, base))
    return folder


def pickled(path, content, protocol=4):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(content, protocol))
    return path


def slide(path, frames=5, start=1581073084.690542596, base=0):
    """A slide, whose lines end with a comma."""
    rows = [
        [f"{start + 0.01 * t:.9f}", 3, 100 + t, 91, *range(base, base + 22), *range(t, t + 19)]
        for t in range(frames)
    ]
    return write_csv(path, SLIDE_COLUMNS, rows, last=",")


def braille_table(letters=("A", "B", "Space"), repetitions=2, frames=4):
    """The rows of the pickled table, of slides of several lengths."""
    rows = []
    for i, letter in enumerate(letters):
        for repetition in range(repetitions):
            length = frames + repetition
            taxels = 200 + 10 * i + repetition + np.arange(length * 12).reshape(length, 12)
            rows.append({"letter": letter, "taxel_data": taxels.tolist()})
    return rows


def braille_npz(path, rows=None, **more):
    rows = braille_table() if rows is None else rows
    counts = [len(row["taxel_data"]) for row in rows]
    content = {
        "x": np.concatenate([np.float32(row["taxel_data"]) for row in rows])[..., None],
        "y": np.repeat([row["letter"] for row in rows], counts),
        "trial": np.repeat(np.arange(len(rows)), counts),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, **{k: v for k, v in {**content, **more}.items() if v is not None})
    return path


def glove(frames=12, **more):
    """The variables of the file of the glove: six recordings of three objects, in turns."""
    count = np.arange(frames)
    pressure = np.full((frames, 32, 32), 500, dtype=np.uint16)
    pressure[:, 3, 4] += (10 * count).astype(np.uint16)
    recording = count % 6
    content = {
        "pressure": pressure,
        "objectId": (recording % 3)[None].astype(np.uint8),
        "recordingId": recording[None].astype(np.uint16),
        "splitId": (recording // 3)[None].astype(np.uint8),
        "batchId": np.zeros((1, frames)),
        "frame": count[None].astype(np.float64),
        "ts": (1e9 + 0.14 * count)[None],
        "hasValidLabel": (count != 1)[None],
        "isBalanced": (count % 2 == 0)[None].astype(np.uint8),
        "objects": cell("mug", "tennis_ball", "empty_hand"),
        "recordings": cell(*(f"recording {i} é" for i in range(6))),
        "splits": cell("train", "test"),
        "batches": cell("batch"),
    }
    return {key: value for key, value in {**content, **more}.items() if value is not None}


def cell(*texts):
    return np.array([list(texts)], dtype=object)


def glove_mat(path, variables=None, packed=True):
    from scipy.io import savemat

    path.parent.mkdir(parents=True, exist_ok=True)
    savemat(path, glove() if variables is None else variables, do_compression=packed)
    return path
