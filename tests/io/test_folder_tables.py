import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from torch_geometric_tactile.data import Annotation, Recording
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.io._folder_tables import (
    read_annotations,
    read_labels,
    write_annotations,
)
from torch_geometric_tactile.io._named_csv import read_named_csv
from torch_geometric_tactile.io._wide_csv import write_wide_csv

HEAD = "recording,start,end,label\n"


def write(folder, name="a", annotations=()):
    path = folder / f"{name}.csv"
    write_wide_csv(Recording([0.0, 0.1], np.ones((2, 1, 1)), annotations=annotations), path)
    return path


def test_annotations_are_written_beside_the_file_and_others_stay(tmp_path):
    table = tmp_path / "annotations.csv"
    table.write_text("note,label,recording,end,start\nby hand,hold,b.csv,2,1\n,slip,a,1,0\n")
    path = write(tmp_path, "a", [(0, 0.1, "=x")])
    assert table.read_text() == (
        "note,label,recording,end,start\nby hand,hold,b.csv,2,1\n,'=x,a,0.1,0.0\n"
    )
    assert read_recording(path).annotations == ((0, 0.1, "=x"),)
    assert read_recording(write(tmp_path, "c")).annotations == ()
    write(tmp_path, "a")
    assert table.read_text() == "note,label,recording,end,start\nby hand,hold,b.csv,2,1\n"
    write(tmp_path, "b")
    assert not table.exists()


def test_annotations_are_read_for_columns_of_any_names(tmp_path):
    (tmp_path / "glove.csv").write_text("time,thumb,index\n0,5,1\n0.01,7,2\n")
    (tmp_path / "annotations.csv").write_text(HEAD + "glove.csv,0,0.005,open\nother,1,2,x\n")
    assert read_named_csv(tmp_path / "glove.csv").annotations == ((0, 0.005, "open"),)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "file,start,stop\na,0,1\n",
            "must have the column 'recording' (3 of 4 columns are missing",
        ),
        (HEAD + "a,0,x,slip\n", "line 2, column 3: 'end' must be a number (got 'x')"),
        (HEAD + "a,2,1,slip\n", "line 2: 'annotations' must have a finite start, and an end"),
        (HEAD + "a,0,1,\n", "line 2: 'annotations' must have labels of 1 to 255"),
        (HEAD, "must hold at least one annotation (got a header only)"),
    ],
)
def test_a_wrong_table_of_annotations_is_refused(tmp_path, text, message):
    path = write(tmp_path)
    table = tmp_path / "annotations.csv"
    table.write_text(text)
    for read in (lambda: read_annotations(table), lambda: read_recording(path)):
        with pytest.raises(ValueError, match=f"annotations.csv'.*{re.escape(message)}"):
            read()
    with pytest.raises(ValueError, match=r"annotations\.csv'"):
        write(tmp_path, "b", [(0, 1, "slip")])
    assert (table.read_text(), (tmp_path / "b.csv").exists()) == (text, False)


def test_labels_are_texts_or_whole_numbers_and_empty_cells_tell_nothing(tmp_path):
    table = tmp_path / "labels.csv"
    table.write_text("recording,label,object,trial,mass\na,slip,mug,1,3\nb,'-x,,2,3.5\n")
    assert read_labels(table) == {
        "a": {"label": "slip", "object": "mug", "trial": 1, "mass": "3"},
        "b": {"label": "-x", "trial": 2, "mass": "3.5"},
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("file,label\na,x\n", "must have the column 'recording'"),
        ("recording,label\na,x\na,y\n", "line 3 must not repeat a recording (got 'a')"),
        ("recording,label\n", "must have a line for at least one recording"),
    ],
)
def test_a_wrong_table_of_labels_is_refused(tmp_path, text, message):
    table = tmp_path / "labels.csv"
    table.write_text(text)
    with pytest.raises(ValueError, match=f"labels.csv'.*{re.escape(message)}"):
        read_labels(table)


WRITER = """
import sys
from pathlib import Path
import numpy as np
from torch_geometric_tactile.data import Annotation, Recording
from torch_geometric_tactile.io._wide_csv import write_wide_csv

folder, name, count = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
spans = [(0.0, 0.1, name)]
print("ready", flush=True)
sys.stdin.readline()
for i in range(count):
    recording = Recording([0.0, 0.1], np.ones((2, 1, 1)), annotations=spans)
    write_wide_csv(recording, folder / f"{name}{i}.csv")
"""


def start_writer(folder, name, count, code=WRITER):
    return subprocess.Popen(
        [sys.executable, "-c", code, str(folder), name, str(count)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def test_processes_that_write_into_one_folder_lose_no_annotations(tmp_path):
    writers = [start_writer(tmp_path, name, 30) for name in "abc"]
    for writer in writers:
        assert writer.stdout.readline() == "ready\n"
    for writer in writers:
        writer.stdin.write("\n")
        writer.stdin.flush()
    for writer in writers:
        writer.communicate()
        assert writer.returncode == 0
    annotations = read_annotations(tmp_path / "annotations.csv")
    assert sorted(annotations) == sorted(f"{name}{i}" for name in "abc" for i in range(30))
    others = [path.name for path in tmp_path.iterdir() if path.suffix != ".csv"]
    assert others == []


def test_threads_that_write_into_one_folder_lose_no_annotations(tmp_path):
    with ThreadPoolExecutor(4) as pool:
        [*pool.map(lambda i: write(tmp_path, f"r{i}", [(0, 0.1, "x")]), range(80))]
    assert len(read_annotations(tmp_path / "annotations.csv")) == 80
    assert not [path for path in tmp_path.iterdir() if path.suffix != ".csv"]


@pytest.mark.skipif(sys.platform == "win32", reason="no signals")
def test_a_lock_of_a_killed_process_holds_nobody_up(tmp_path):
    code = """
import sys, time
from torch_geometric_tactile._files import exclusive_access
with exclusive_access(sys.argv[1] + "/annotations.csv"):
    print("ready", flush=True)
    time.sleep(100)
"""
    holder = start_writer(tmp_path, "a", 1, code)
    assert holder.stdout.readline() == "ready\n"
    assert [path.name for path in tmp_path.iterdir()] == [".annotations.csv.lock"]
    waiter = start_writer(tmp_path, "b", 1)
    waiter.stdin.write("\n")
    waiter.stdin.flush()
    assert waiter.stdout.readline() == "ready\n"
    with pytest.raises(subprocess.TimeoutExpired):
        waiter.wait(0.5)
    holder.kill()
    holder.communicate()
    assert waiter.wait(60) == 0
    waiter.communicate()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["annotations.csv", "b0.csv"]


def test_tables_of_a_spreadsheet_with_decimal_commas(tmp_path):
    (tmp_path / "annotations.csv").write_text("recording;start;end;label\na;0,5;1,25;a, b\n")
    (tmp_path / "labels.csv").write_text("recording;label;object\na;slip;mug\n")
    annotations = read_annotations(tmp_path / "annotations.csv")
    assert annotations == {"a": [(0.5, 1.25, "a, b")]}
    assert read_labels(tmp_path / "labels.csv") == {"a": {"label": "slip", "object": "mug"}}
    write_annotations(tmp_path / "b.npz", [Annotation(2.0, 3.0, "hold")])
    assert read_annotations(tmp_path / "annotations.csv") == {
        **annotations,
        "b": [(2.0, 3.0, "hold")],
    }
