import errno
import io
import logging
import tempfile
from dataclasses import replace

import numpy as np
import pytest
import torch
from recordings import counting_recording
from torch_geometric.data import Data

from torch_geometric_tactile.data import Protocol, Recording, StaticDataset
from torch_geometric_tactile.datasets import FakeTactileDataset, RecordingFrames
from torch_geometric_tactile.io import read_recording, write_recording
from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin, grid
from torch_geometric_tactile.transforms import KNNGraph

GLOVE = TaxelLayout("glove", [[0.0, 0.0], [0.01, 0.0]], adjacency={"pair": [[0, 1], [1, 0]]})


def recording(value=0.0, frames=3, channels=1, taxels=2, label=None, joints=0, phase=None, **meta):
    return counting_recording(
        *(frames, taxels, channels),
        rate=10,
        offset=value,
        label=label,
        joints=joints,
        phase=phase,
        meta=meta,
    )


def write_glove(folder, names=("cup_0", "cup_1", "ball_0", "ball_1"), grasps=("pinch", "palm")):
    """CSV files with a time in milliseconds, two taxels and a label that is one grasp a file."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, name in enumerate(names):
        lines = ["Timestamp,thumb,index,grasp"]
        lines += [f"{20 * t},{10 * i + t},{t},{grasps[i % len(grasps)]}" for t in range(5)]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    return folder


READ = {"label": "grasp", "time_unit": "ms"}
PERSONS = "{person}_{object}_{trial}"


def test_glove_from_csv_files_by_hand(tmp_path):
    GLOVE.save(tmp_path / "glove.json")
    root = write_glove(tmp_path / "grasps")
    dataset = RecordingFrames(
        root, layout=tmp_path / "glove.json", target="label", read_options=READ
    )
    assert repr(dataset) == "RecordingFrames(20)"
    assert dataset.class_names == ["palm", "pinch"]
    assert dataset.group_names == ["ball", "cup"]
    assert dataset.trial_names == ["ball_0", "ball_1", "cup_0", "cup_1"]
    data = dataset.data
    assert data.x[:, :, 0].tolist() == [[10.0 * i + t, t] for i in (2, 3, 0, 1) for t in range(5)]
    assert data.y.tolist() == [1] * 5 + [0] * 5 + [1] * 5 + [0] * 5
    assert data.group.tolist() == [0] * 10 + [1] * 10
    assert data.time[:2].tolist() == [0.0, 0.02]
    assert data.edge_index.tolist() == [[0, 1], [1, 0]]
    assert data.pos.equal(GLOVE.pos)
    assert "joint" not in data
    objects = RecordingFrames(root, layout=GLOVE, read_options=READ)
    assert objects.class_names == ["ball", "cup"]
    assert objects.data.y.equal(objects.data.group)


def test_recordings_of_live_streams(tmp_path):
    for module in ("mcap", "google.protobuf"):
        pytest.importorskip(module, reason="needs the extra 'live'")
    write_recording(recording(label="cup"), tmp_path / "cup_0.mcap")
    write_recording(recording(10.0, label="ball"), tmp_path / "ball_0.npz")
    dataset = RecordingFrames(tmp_path, layout=GLOVE, target="label")
    assert dataset.trial_names == ["ball_0", "cup_0"]
    assert dataset.data.x[:, 0, 0].tolist() == [10, 11, 12, 0, 1, 2]


def test_second_time_reads_no_raw_file_and_other_settings_read_again(tmp_path, caplog):
    root = write_glove(tmp_path)
    given = {"layout": GLOVE, "read_options": READ}
    RecordingFrames(root, target="label", **given)
    with caplog.at_level(logging.WARNING):
        protocol = Protocol("trial", val=0, test=0.5)
        part = RecordingFrames(
            root, target="label", protocol=protocol, split="test", stride=2, **given
        )
    assert len(part) == 6
    with caplog.at_level(logging.WARNING):
        RecordingFrames(root, target="label", protocol=Protocol("frame"), split="val", **given)
    assert not caplog.text
    RecordingFrames(root, **given)
    assert "again: target: 'label' -> " in caplog.text
    caplog.clear()
    moved = TaxelLayout("glove", GLOVE.pos + 0.01, adjacency=GLOVE.adjacency)
    dataset = RecordingFrames(root, layout=moved, read_options=READ)
    assert "again: layout: TaxelLayout('glove'" in caplog.text
    assert dataset.data.pos.equal(moved.pos)
    (root / "cup_0.csv").unlink()
    assert len(RecordingFrames(root, layout=moved, read_options=READ)) == 15
    assert "'cup_0.csv' was removed" in caplog.text


def test_object_and_property_targets_share_a_processed_file(tmp_path, caplog):
    for i, name in enumerate(("a_0", "b_0")):
        made = recording(labels=[i, 1], label_names=["soft", "wet"])
        write_recording(made, tmp_path / f"{name}.npz")
    with caplog.at_level(logging.WARNING):
        objects = RecordingFrames(tmp_path, layout=GLOVE)
        properties = RecordingFrames(tmp_path, layout=GLOVE, target="property")
    assert "again" not in caplog.text
    assert objects.data.y.tolist() == [0, 0, 0, 1, 1, 1]
    assert properties.class_names == properties.property_names == ["soft", "wet"]
    assert properties.data.y.tolist() == [[0, 1]] * 3 + [[1, 1]] * 3


def test_property_names_in_another_order_and_unknown_ones():
    made = [
        recording(labels=[1, 0], label_names=["soft", "wet"], object="a"),
        recording(labels=[1, 0], label_names=["wet", "soft"], object="b"),
    ]
    dataset = RecordingFrames(layout=GLOVE, recordings=made, target="property")
    assert dataset.data.y[::3].tolist() == [[1, 0], [0, 1]]
    made.append(recording(labels=[1], label_names=["soft"], object="c"))
    assert "property" not in RecordingFrames(layout=GLOVE, recordings=made).data
    with pytest.raises(ValueError, match=r"properties of \['c'\] are unknown: write 0 or 1"):
        RecordingFrames(layout=GLOVE, recordings=made, target="property")


def test_frames_have_the_actions_of_demonstrations_if_all_recordings_have_them(tmp_path):
    made = [
        replace(recording(object=name), action=np.full((3, 2), i)) for i, name in enumerate("ab")
    ]
    (tmp_path / "raw").mkdir()
    for i in range(2):
        write_recording(made[i], tmp_path / f"raw/{i}.npz")
    in_memory = RecordingFrames(layout=GLOVE, recordings=made)
    # Read from the files, and from the processed file.
    in_files = [RecordingFrames(tmp_path, layout=GLOVE) for _ in range(2)]
    for dataset in (in_memory, *in_files):
        assert dataset.data.action.tolist() == [[0, 0]] * 3 + [[1, 1]] * 3
        assert dataset[4].action.tolist() == [[1, 1]]
    mixed = [made[0], recording(object="b")]
    assert "action" not in RecordingFrames(layout=GLOVE, recordings=mixed).data
    other = replace(made[1], action=np.zeros((3, 5)))
    with pytest.raises(
        ValueError, match=r"recording 1 must have 2 actions per frame, like rec.*got 5"
    ):
        RecordingFrames(layout=GLOVE, recordings=[made[0], other])


def test_recordings_in_memory_with_any_channels_and_joints():
    made = [recording(10 * i, channels=5, joints=2, object=f"o{i % 2}") for i in range(4)]
    dataset = RecordingFrames(layout=GLOVE, recordings=made)
    assert dataset.data.x.shape == (12, 2, 5)
    assert dataset.data.joint.shape == (12, 2)
    assert dataset.trial_names == ["0", "1", "2", "3"]
    assert dataset[4].x.eq(11.0).all()
    assert isinstance(dataset, StaticDataset)


def test_hand_with_links_has_no_positions_of_its_own():
    made = [recording(taxels=384, channels=3, joints=16, object=name) for name in "ab"]
    dataset = RecordingFrames(layout="allegro_uskin", recordings=made, adjacency="sparse")
    assert "pos" not in dataset.data
    assert dataset[0].num_edges == 1000
    assert dataset.layout.matches(allegro_uskin())


def named(*names):
    edges = {name: [[0, i], [i, 0]] for i, name in enumerate(names, 1)}
    return TaxelLayout("pad", torch.rand(4, 3), adjacency=edges)


@pytest.mark.parametrize(
    ("layout", "expected"),
    [
        (named("b", "original", "a"), "original"),
        (named("only"), "only"),
        (named("one", "other"), None),
        (named(), None),
        (TaxelLayout.join([named("original")] * 2, ["a", "b"]), "original"),
    ],
)
def test_edges_without_a_named_adjacency_are_the_same_everywhere(layout, expected):
    made = [recording(taxels=len(layout), object=name) for name in "ab"]
    x = torch.zeros(2, len(layout), 3)
    found = [
        RecordingFrames(layout=layout, recordings=made),
        StaticDataset.from_arrays(x, layout=layout),
        FakeTactileDataset(4, layout=layout),
    ]
    assert layout.default_adjacency == expected
    for dataset in found:
        if expected is None:
            assert dataset.data.edge_index is None
        else:
            assert dataset.data.edge_index.equal(layout.edge_index(expected))


def test_one_object_only_names_the_option(caplog):
    made = [recording(object="mug", label=label) for label in ("slip", "hold")]
    RecordingFrames(layout=GLOVE, recordings=made, target="label")
    assert "one object" not in caplog.text
    RecordingFrames(layout=GLOVE, recordings=made)
    assert "only one object, 'mug', " in caplog.text
    assert "choose another target with target='label' or" in caplog.text


def test_edges_of_a_transform_replace_those_of_the_layout():
    made = [recording(taxels=6, object=name) for name in "ab"]
    layout = grid(2, 3, 0.01)
    dataset = RecordingFrames(layout=layout, recordings=made, pre_transform=KNNGraph(2))
    assert dataset[0].edge_index.equal(KNNGraph(2)(Data(pos=layout.pos)).edge_index)
    pads = TaxelLayout.join([layout] * 2, ["a", "b"])
    made = [recording(taxels=12, object=name) for name in "ab"]
    with pytest.raises(
        ValueError, match=r"KNNGraph needs 'pos' \(got none\): .* put TaxelPose before"
    ):
        RecordingFrames(layout=pads, recordings=made, pre_transform=KNNGraph(2))


@pytest.mark.parametrize(
    ("target", "classes", "y"),
    [
        ("label", ["3", "10", "slip"], [1, 0, 2]),
        ("surface", ["dry", "wet"], [1, 0, 1]),
        ("contact", ["0", "1"], None),
    ],
)
def test_targets_of_your_own(target, classes, y):
    made = []
    for label, surface in ((10, "wet"), (3, "dry"), ("slip", "wet")):
        base = recording(label=label, surface=surface)
        touched = {"contact": np.array([False, True, True])}
        made.append(Recording(base.time, base.tactile, None, label, base.meta, touched))
    dataset = RecordingFrames(layout=GLOVE, recordings=made, target=target)
    assert dataset.class_names == classes
    assert dataset.num_classes == len(classes)
    expected = [0, 1, 1] * 3 if y is None else [i for i in y for _ in range(3)]
    assert dataset.data.y.tolist() == expected
    assert "group" not in dataset.data


def test_pattern_reads_names_of_files_and_folders(tmp_path):
    for folder, name in (("dry", "cup-anna-1"), ("wet", "cup-ben-1"), ("wet", "cup-ben-2")):
        (tmp_path / "raw" / folder).mkdir(parents=True, exist_ok=True)
        write_recording(recording(), tmp_path / "raw" / folder / f"{name}.npz")
    write_recording(recording(), tmp_path / "raw" / "wet" / ".hidden-ben-3.npz")
    dataset = RecordingFrames(
        tmp_path,
        layout=GLOVE,
        target="surface",
        pattern=r"(?P<surface>\w+)/(?P<object>\w+)-(?P<session>\w+)-(?P<repeat>\d+)",
    )
    assert dataset.class_names == ["dry", "wet"]
    assert dataset.session_names == ["anna", "ben"]
    assert dataset.data.session[::3].tolist() == [0, 1, 1]
    assert dataset.trial_names == ["dry/cup-anna-1", "wet/cup-ben-1", "wet/cup-ben-2"]


def write_persons(folder):
    """Trial 0 and 1 of a cup and a ball, by each of two persons."""
    names = [
        f"p{p}_{thing}_{i:03d}" for p in (1, 2) for thing in ("big_cup", "ball") for i in (0, 1)
    ]
    return write_glove(folder, names, ["pinch"])


def test_names_in_braces_are_a_pattern(tmp_path):
    root = write_persons(tmp_path)
    dataset = RecordingFrames(root, layout=GLOVE, read_options=READ, pattern=PERSONS)
    assert dataset.class_names == ["ball", "big_cup"]
    assert len(dataset.trial_names) == 8
    assert (dataset.named_units, dataset.group_kind) == (["person"], "object")
    train, _, test = Protocol("person", val=0, test=0.5).split(dataset)
    persons = [{dataset.trial_names[i][:2] for i in dataset.trial[part]} for part in (train, test)]
    assert [len(part) for part in persons] == [1, 1]
    assert persons[0] != persons[1]


def test_group_of_the_pattern_is_the_group_without_objects(tmp_path):
    root = write_persons(tmp_path)
    pattern = r"(?P<group>p\d)_(?P<label>.+)_(?P<trial>\d+)"
    dataset = RecordingFrames(
        root,
        layout=GLOVE,
        target="label",
        read_options={"ignore": ["grasp"], "time_unit": "ms"},
        pattern=pattern,
    )
    assert (dataset.group_names, dataset.group_kind) == (["p1", "p2"], "group")
    with pytest.raises(ValueError, match=r"'pattern' must name an object or a group.*\(got both\)"):
        RecordingFrames(root, layout=GLOVE, pattern="{group}_{object}_{trial}")


def test_files_that_do_not_match_the_pattern_are_named(tmp_path, caplog):
    root = write_persons(tmp_path)
    write_glove(root, ["notes"])
    RecordingFrames(root, layout=GLOVE, target="label", read_options=READ, pattern=PERSONS)
    assert "1 of 9 file names do not match the pattern '(?P<person>" in caplog.text
    assert "notes.csv'" in caplog.text


def test_column_of_the_table_of_labels_is_a_unit(tmp_path):
    root = write_glove(tmp_path)
    names = ["cup_0", "cup_1", "ball_0", "ball_1"]
    rows = [f"{name},{person}" for name, person in zip(names, (7, 7, 8, 8), strict=True)]
    (root / "labels.csv").write_text("\n".join(["recording,person", *rows]) + "\n")
    dataset = RecordingFrames(root, layout=GLOVE, read_options=READ)
    test = Protocol("person", val=0, test=0.5).split(dataset).test
    assert {dataset.trial_names[i][:-2] for i in dataset.trial[test]} in ({"cup"}, {"ball"})


def test_parts_of_a_protocol_are_disjoint_and_complete():
    made = [recording(10 * i, label=f"{i % 2}", frames=4) for i in range(10)]
    protocol = Protocol("trial", folds=5, val=0.25, stratify="y")
    for fold in (0, 3):
        parts = [
            RecordingFrames(
                layout=GLOVE,
                recordings=made,
                target="label",
                split=split,
                protocol=protocol,
                split_seed=2,
                fold=fold,
            )
            for split in ("train", "val", "test")
        ]
        indices = [set(part.indices()) for part in parts]
        assert set.union(*indices) == set(range(40))
        assert sum(map(len, indices)) == 40
        assert parts[2].column("y").bincount().tolist() == [4, 4]
        whole = RecordingFrames(layout=GLOVE, recordings=made, target="label")
        assert indices[2] == set(protocol.split(whole, 2, fold).test.tolist())


def test_phases_and_stride():
    names = ["reach", "hold"]
    made = [recording(frames=4, phase=[0, 0, 1, 1], phase_names=names, label="a") for _ in range(2)]
    given = {"layout": GLOVE, "recordings": made, "target": "label"}
    assert list(RecordingFrames(phases="hold", **given).indices()) == [2, 3, 6, 7]
    assert list(RecordingFrames(stride=3, **given).indices()) == [0, 3, 4, 7]
    message = r"split='None' with protocol='by trial.*phases=\('hold',\) must leave .* of 8 samples"
    with pytest.raises(ValueError, match=message):
        RecordingFrames(phases="hold", stride=9, **given)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"recordings": [recording()], "pattern": "("}, "'pattern' must be a regular expression"),
        ({"recordings": [], "unit": "gram"}, r"'unit' must be one of .* \(got 'gram'\)"),
        ({}, r"one of 'root' and 'recordings' must be given \(got none\)"),
        ({"root": "a", "recordings": []}, r"one of 'root' and 'recordings' .* \(got both\)"),
        (
            {"recordings": [], "layout": None},
            r"'layout' must name the taxel .* \(got None\)",
        ),
        ({"recordings": []}, r"'recordings' must hold at least one recording \(got none\)"),
        ({"recordings": [], "split": "dev"}, r"'split' must be 'train', 'val', 'test' or None"),
        ({"recordings": [], "stride": 0}, r"'stride' must be at least 1 \(got 0\)"),
        ({"recordings": [], "adjacency": "x"}, r"'name' must be an adjacency of layout 'glove'"),
        ({"recordings": [recording(taxels=3)]}, r"recording 0: .* must have 2 taxels \(got 3\)"),
        ({"recordings": [recording()]}, r"recording 0 must name its object and trial"),
        (
            {"recordings": [recording(column_names={"tactile": ["a", "a"]})]},
            r"recording 0: 'column_names' in 'meta' must name each",
        ),
        (
            {"recordings": [recording(object="a"), recording(object="a", channels=2)]},
            r"recording 1 must have 1 channels per taxel, like recording 0 \(got 2\)",
        ),
        (
            {"recordings": [recording(object="a"), recording(object="a", joints=2)]},
            r"recording 1 must have 0 joint angles per frame, like recording 0 \(got 2\)",
        ),
        (
            {"recordings": [recording(label="a"), recording()], "target": "label"},
            r"recording 1 must have 'label', a text or an integer, .* \(got None\)",
        ),
        (
            {"recordings": [recording(surface=1.5)], "target": "surface"},
            r"recording 0 must have 'surface', a text or an integer, .* \(got 1.5\)",
        ),
    ],
)
def test_rejects(arguments, message):
    with pytest.raises(ValueError, match=message):
        RecordingFrames(**{"layout": GLOVE, **arguments})


def test_subclass_reads_a_format_of_its_own(tmp_path):
    class Squared(RecordingFrames):
        def read_trial(self, path):
            made = super().read_trial(path)
            return Recording(made.time, made.tactile**2, label=made.label)

    root = write_glove(tmp_path)
    dataset = Squared(root, layout=GLOVE, read_options=READ)
    assert dataset.data.x[4, 1, 0] == 16


def test_unit_of_recordings_that_name_none_is_declared():
    made = [recording(object="a", unit="newton"), recording(object="b")]
    with pytest.raises(
        ValueError, match=r"'newton' in recording 0 and 'none' in recording 1.*'unit"
    ):
        RecordingFrames(layout=GLOVE, recordings=made)
    assert len(RecordingFrames(layout=GLOVE, recordings=made, unit="newton")) == 6
    with pytest.raises(ValueError, match=r"'newton' in recording 0 and 'count' in recording 1"):
        RecordingFrames(layout=GLOVE, recordings=made, unit="count")


def test_label_of_the_file_and_of_its_folder_differ(tmp_path):
    path = tmp_path / "slip" / "a.npz"
    path.parent.mkdir()
    write_recording(recording(label="hold"), path)
    pattern = "(?P<label>[^/]+)/.*"
    with pytest.raises(ValueError, match=r"a\.npz' must have one label \(got 'hold' .* 'slip' in"):
        RecordingFrames(tmp_path, GLOVE, target="label", pattern=pattern)
    write_recording(recording(label="slip"), path)
    assert RecordingFrames(tmp_path, GLOVE, target="label", pattern=pattern).class_names == ["slip"]


def test_names_of_phases_that_are_none():
    made = [recording(object="a", phase=[0, 1, 1], phase_names="ab")]
    with pytest.raises(ValueError, match="recording 0 must have different texts in 'phase_names'"):
        RecordingFrames(layout=GLOVE, recordings=made)


def test_full_disk_while_frames_are_gathered_names_the_folder(tmp_path, monkeypatch):
    class Full(io.BytesIO):
        def write(self, data):
            raise OSError(errno.ENOSPC, "full")

    root = write_glove(tmp_path / "grasps")
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **kwargs: Full())
    with pytest.raises(OSError, match=r"No space left on device: '.*grasps"):
        RecordingFrames(root, layout=GLOVE, read_options=READ)


def test_target_is_the_column_of_the_label_even_if_it_never_changes(tmp_path):
    header = "time,a,b,grasp"
    (tmp_path / "mug_0.csv").write_text(f"{header}\n0,1,2,pinch\n1,1,2,power\n")
    (tmp_path / "mug_1.csv").write_text(f"{header}\n0,1,2,pinch\n1,1,2,pinch\n")
    options = {"layout": grid(1, 2, 0.01), "read_options": {"label": "grasp", "time_unit": "s"}}
    dataset = RecordingFrames(tmp_path, target="grasp", **options)
    assert (dataset.class_names, dataset.data.y.tolist()) == (["pinch", "power"], [0, 1, 0, 0])
    with pytest.raises(ValueError, match="changes from frame to frame: choose target='grasp'"):
        RecordingFrames(tmp_path, target="label", **options)


# Neither in the order of the numbers nor in that of texts, as of a sensor that is wired so.
NAMES = ["pad1_x0", "pad1_y0", "pad1_x9", "pad1_y9", "pad1_x4", "pad1_y4", "q_b", "q_a"]
COLUMNS = {"tactile": r"pad1_[xy]\d+", "joint": "q_.", "num_channels": 2}
LABELLED = {"target": "label", "pattern": r"(?P<label>[a-z]+)_\d+"}


def write_columns(folder, count, shuffled=None):
    """CSV files in which a cell tells its column; those of one file in another order."""
    for i in range(count):
        names = NAMES[:: -1 if i == shuffled else 1]
        cells = ",".join(f"{(1 + NAMES.index(name)) / 10}" for name in names)
        lines = [f"t,{','.join(names)}", f"0,{cells}", f"1,{cells}"]
        (folder / f"mug_{i:02}.csv").write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("options", [COLUMNS, {"joint": "q_.", "num_channels": 2}])
@pytest.mark.parametrize("convert", [False, True])
def test_columns_have_the_order_of_the_first_file_in_all_files(tmp_path, options, convert):
    write_columns(tmp_path, 12, shuffled=7)
    known = {"root": tmp_path, "read_options": options}
    if convert:  # the names go with a recording, also into another format
        known = {"recordings": []}
        for path in sorted(tmp_path.glob("*.csv")):
            write_recording(read_recording(path, **options), path.with_suffix(".npz"))
            known["recordings"].append(read_recording(path.with_suffix(".npz")))
            known["recordings"][-1] = replace(known["recordings"][-1], label="mug")
    for _ in range(2):  # also of the processed file
        dataset = RecordingFrames(layout=grid(1, 3, 0.01), **LABELLED, **known)
        assert len(dataset) == 24
        assert dataset.data.x.allclose(torch.tensor([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]]))
        assert dataset.data.joint.allclose(torch.tensor([0.7, 0.8]))
        assert dataset.file_options["tactile"] == NAMES[:6]
        assert dataset.file_options["joint"] == NAMES[6:]


def test_columns_of_other_names_are_refused_with_the_file(tmp_path):
    write_columns(tmp_path, 2)
    names = ["pad1_x1", *NAMES[1:]]
    (tmp_path / "mug_02.csv").write_text(f"t,{','.join(names)}\n0{',1' * len(names)}\n")
    message = r"mug_02.csv': its columns of 'tactile' .* \(got 'pad1_x1' in place of 'pad1_x0'\)"
    with pytest.raises(ValueError, match=message):
        RecordingFrames(tmp_path, layout=grid(1, 3, 0.01), read_options=COLUMNS, **LABELLED)


def test_channels_that_were_not_declared_are_asked_for(tmp_path):
    write_columns(tmp_path, 1)
    options = {**COLUMNS, "num_channels": 1}
    with pytest.raises(
        ValueError, match=r"3 taxels \(got 6\): if each taxel has 2 .* num_channels=2"
    ):
        RecordingFrames(tmp_path, layout=grid(1, 3, 0.01), read_options=options, **LABELLED)


def test_spellings_of_labels_and_objects_are_one():
    labels, objects = ("slip", "Slip ", "hold", "slip"), ("Cup", "cup", "pen", "cup ")
    recordings = [
        recording(label=label, object=name, trial=i)
        for i, (label, name) in enumerate(zip(labels, objects, strict=True))
    ]
    layout = grid(1, 2, pitch=0.01)
    frames = RecordingFrames(layout=layout, recordings=recordings, target="label")
    assert frames.class_names == ["hold", "slip"]
    assert frames.y[::3].tolist() == [1, 1, 0, 1]
    assert (frames.group_names, frames.group[::3].tolist()) == (["Cup", "pen"], [0, 0, 1, 0])


def test_label_minus_one_beside_zero_is_no_class(caplog):
    recordings = [recording(label=i, object="cup", trial=i + 1) for i in (-1, 0, 1)]
    frames = RecordingFrames(layout=grid(1, 2, pitch=0.01), recordings=recordings, target="label")
    assert (frames.class_names, frames.y[::3].tolist()) == (["0", "1"], [-1, 0, 1])
    assert "3 of 9 frames have the label -1, which means unlabelled" in caplog.text
    assert frames[frames.y >= 0].y.unique().tolist() == [0, 1]
