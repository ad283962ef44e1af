"""Readers that misbehave in each way are found out, and the whole files are read as they must."""

# ruff: noqa: E402
import ctypes
import os
import time
from pathlib import Path

import pytest

for extra in ("yaml", "h5py", "PIL", "lightning", "mcap", "google.protobuf", "pyarrow"):
    pytest.importorskip(extra, reason="needs the extras 'io', 'lerobot', 'live' and 'train'")

from fuzz import oracles, tree_oracles
from fuzz.laws import FAILURES, REFUSED, REWRITTEN, Refused, difference, equal
from fuzz.run import attack, main, make_whole, preload
from fuzz.targets import TARGETS, Target, schedule
from fuzz.worker import Draw, draw_case

WHOLE = b"1,2\n"


def make(folder):
    (folder / "a.txt").write_bytes(WHOLE)


def mutate(path, data, draw, other):
    path.write_bytes(b"1,3\n")
    return "judged"


def careful(read):
    """A reader that reads the whole file as it is."""
    return lambda path: [1, 2] if path.read_bytes() == WHOLE else read(path)


def judged(read, says=None, seconds=2.0, allowed="judged"):
    """The outcome of the one case of a reader."""

    def change(path, data, draw, other):
        mutate(path, data, draw, other)
        return allowed

    target = Target("reader", make, careful(read), change, says)
    ((_, result),) = attack([target], [0], seconds=seconds)
    return result


def complaint(text, kind=ValueError):
    def read(path):
        raise kind(text.format(path))

    return read


def grow(path):
    return len(bytearray(b"1") * (9 * 2**26))


def ask_for_too_much(path):
    return bytearray(2**40)


def sleep(path):
    time.sleep(60)


def spin(path):
    while True:
        pass


def leave_a_file(path):
    Path("MARKER").touch()
    return [1, 2]


def run_a_program(path):
    os.system("true")
    return [1, 2]


def remove(path):
    path.unlink()
    return [1, 2]


OUTCOMES = [
    (lambda path: [1, 2], "same"),
    (lambda path: [1, 3], "silent"),
    (lambda path: [1, 2.0], "silent"),
    (complaint("'{}' is damaged"), "error"),
    (complaint("'{}' is locked", BlockingIOError), "error"),
    (complaint("it is damaged"), "wrong error"),
    (complaint("'{}' is damaged", KeyError), "wrong error"),
    (complaint("'{}' is too deep", RecursionError), "wrong error"),
    (complaint("'{}' ends the program", SystemExit), "wrong error"),
    (lambda path: os._exit(0), "crash"),
    (lambda path: os.abort(), "crash"),
    (lambda path: ctypes.string_at(0), "crash"),
    (grow, "memory"),
    (ask_for_too_much, "memory"),
    (leave_a_file, "ran code"),
    (run_a_program, "ran code"),
    (remove, "ran code"),
]


def test_readers_that_misbehave_are_found_out():
    targets = [
        Target(f"reader {i}", make, careful(read), mutate) for i, (read, _) in enumerate(OUTCOMES)
    ]
    results = attack(targets, range(len(targets)), seconds=2.0)
    assert [result.outcome for _, result in results] == [outcome for _, outcome in OUTCOMES]


@pytest.mark.full
@pytest.mark.parametrize("read", [sleep, spin])
def test_a_reader_that_never_ends_is_found_out(read):
    assert judged(read, seconds=0.5).outcome == "hang"


def test_what_is_allowed_depends_on_the_mutation():
    assert judged(lambda path: [1, 2], allowed=REFUSED).outcome == "silent"
    assert judged(lambda path: [7], allowed=REWRITTEN).outcome == "rewritten"


def test_a_mutated_cell_is_judged_by_the_reference_reader():
    def says(data):
        if data == b"1,3\n":
            return [1, 3]
        raise Refused

    assert judged(lambda path: [1, 3], says).outcome == "cell"
    assert judged(lambda path: [1, 4], says).outcome == "silent"
    assert judged(lambda path: [1, 3], tree_oracles.json_tree).outcome == "silent"


def test_a_worker_goes_on_after_a_crash_and_keeps_its_file(tmp_path):
    def read(path):
        return [1, 2] if path.read_bytes() == WHOLE else os._exit(1)

    targets = [Target("bad", make, read, mutate), Target("good", make, lambda path: [1], mutate)]
    found = attack(targets, [0, 1, 2, 3], save=tmp_path)
    assert [result.outcome for _, result in found] == ["crash", "same", "crash", "same"]
    assert (tmp_path / "crash_bad_0_2" / "a.txt").read_bytes() == b"1,3\n"


def test_a_case_is_the_same_file_whatever_ran_before(tmp_path):
    target = next(target for target in TARGETS if target.name == "wide CSV")
    (tmp_path / "whole").mkdir()
    target.make(tmp_path / "whole")
    for name in ("a", "b"):
        draw_case(target, tmp_path / "whole", tmp_path / name, 0, 7)
    draw_case(target, tmp_path / "whole", tmp_path / "c", 1, 7)
    files = [[p.read_bytes() for p in (tmp_path / name).iterdir()] for name in "abc"]
    assert files[0] == files[1] != files[2]


@pytest.mark.filterwarnings("ignore")
def test_reference_readers_agree_on_whole_files(tmp_path):
    preload()
    texts = [target for target in TARGETS if target.says is not None and not target.tree]
    make_whole(texts, tmp_path)
    assert len(texts) > 5
    for target in texts:
        for path in (tmp_path / target.name).glob(f"*{target.suffix}"):
            found, said = target.read(path), target.says(path.read_bytes())
            assert equal(found, said), difference(found, said)


@pytest.mark.parametrize(
    ("says", "text"),
    [
        (oracles.wide_csv, "time,taxel_0_x\n0,1\n\n1,2\n"),
        (oracles.wide_csv, "time,taxel_0_x\n0,1\n0,2\n"),
        (oracles.wide_csv, "time,taxel_0_x\n0,1"),
        (oracles.wide_csv, "time,taxel_0_x,taxel_0_x\n0,1,2\n"),
        (oracles.named_csv, "0,1\n0,1\n"),
        (oracles.icub_txt, "-10000\n1 2 3\n"),
        (tree_oracles.json_tree, '{"a": 1, "a": 2}'),
        (tree_oracles.json_tree, '{"a": NaN}'),
        (tree_oracles.yaml_tree, "a: 1\na: 2\n"),
        (oracles.xela_messages, '"time": 3}\n'),
    ],
)
def test_reference_readers_do_not_guess(says, text):
    with pytest.raises(Refused):
        says(text.encode())


def test_the_draw_remembers_the_names_of_functions():
    draw = Draw("0 0")
    draw.choice([make])
    draw.choice([3])
    assert draw.chosen == ["make"]


def test_run_prints_a_table_and_fails_only_on_failures(capsys, monkeypatch):
    good = Target("good", make, lambda path: [1], mutate)
    monkeypatch.setattr("fuzz.run.schedule", lambda: [good])
    assert main(["--cases", "3", "--workers", "1"]) == 0
    assert "good" in capsys.readouterr().out
    bad = Target("bad", make, lambda path: path.read_bytes().decode(), mutate)
    monkeypatch.setattr("fuzz.run.schedule", lambda: [bad])
    assert main(["--only", "5"]) == 1
    assert "python tests/fuzz/run.py --seed 0 --only 5" in capsys.readouterr().out


def test_every_target_is_in_the_schedule():
    assert {target.name for target in schedule()} == {target.name for target in TARGETS}
    assert len({target.name for target in TARGETS}) == len(TARGETS)
    assert not {*FAILURES} & {"same", "cell", "rewritten", "error"}
