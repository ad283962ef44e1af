import json
import subprocess
import sys
import textwrap

import numpy as np
import pytest
import torch

from torch_geometric_tactile.sensors import TaxelLayout, grid, letter_array
from torch_geometric_tactile.sim import (
    LETTERS,
    LetterPress,
    simulate_letters,
)
from torch_geometric_tactile.sim.simulate_letters import num_letter_files

module = sys.modules["torch_geometric_tactile.sim.simulate_letters"]


@pytest.fixture
def small_blocks(monkeypatch):
    monkeypatch.setattr(module, "_BLOCK_SIZE", 3)


def run(out, presses=2, **kwargs):
    return list(simulate_letters(out, presses, **{"letters": "AZ", **kwargs}))


def content(out):
    return {
        str(path.relative_to(out)): np.load(path).tolist() for path in sorted(out.rglob("*.npy"))
    }


def names(out):
    return sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())


def thinned():
    full = letter_array()
    return TaxelLayout("thin", full.pos[::2], image_map=full.image_map[::2])


def test_folder_for_each_letter(tmp_path):
    reports = list(simulate_letters(tmp_path, 1))
    assert [report.letter for report in reports] == list(LETTERS)
    assert {(report.first, report.presses, report.kept) for report in reports} == {(0, 1, False)}
    assert names(tmp_path) == [*(f"{x}/{x}_0000.npy" for x in LETTERS), "simulation.json"]
    for report in reports:
        block = np.load(report.path)
        assert block.shape == (1, 32, 32)
        assert block.dtype == np.float32
        assert 10 < block.max() <= 100
    summary = json.loads((tmp_path / "simulation.json").read_text())
    assert summary["synthetic"] is True
    assert (summary["unit"], summary["seed"], summary["layout"]) == ("kPa", 0, "letter_array")
    assert summary["press"]["pressure"] == [30.0, 75.0]


def test_blocks_of_presses(tmp_path, small_blocks):
    reports = run(tmp_path, presses=7)
    assert [(r.letter, r.first, r.presses) for r in reports] == [
        (letter, *block) for letter in "AZ" for block in ((0, 3), (3, 3), (6, 1))
    ]
    assert len(reports) == num_letter_files(7, "AZ")
    assert np.load(tmp_path / "Z" / "Z_0003.npy").shape == (3, 32, 32)


def test_press_is_a_function_of_seed_letter_and_number(tmp_path):
    run(tmp_path)
    model = LetterPress()
    for letter, number in (("A", 0), ("Z", 25)):
        block = np.load(tmp_path / letter / f"{letter}_0000.npy")
        for i in range(2):
            rng = np.random.default_rng([0, number, i])
            assert np.array_equal(block[i].ravel(), model.press(letter, 1, rng).readings[0])


def test_other_seed_makes_other_presses(tmp_path):
    run(tmp_path / "a")
    run(tmp_path / "b", seed=1)
    first, second = content(tmp_path / "a"), content(tmp_path / "b")
    assert first.keys() == second.keys()
    assert all(first[name] != second[name] for name in first)


@pytest.mark.full
@pytest.mark.slow
def test_processes_do_not_matter(tmp_path, small_blocks):
    model = LetterPress(bits=None)  # all bits of a float
    run(tmp_path / "a", presses=5, press=model)
    reports = run(tmp_path / "b", presses=5, press=model, jobs=2)
    assert content(tmp_path / "a") == content(tmp_path / "b")
    assert {str(report.path.relative_to(tmp_path / "b")) for report in reports} == set(
        content(tmp_path / "a")
    )


def test_more_presses_begin_with_the_same(tmp_path, small_blocks):
    run(tmp_path / "a", presses=1)
    run(tmp_path / "b", presses=2)
    one, two = content(tmp_path / "a"), content(tmp_path / "b")
    assert all(two[name][:1] == one[name] for name in one)
    run(tmp_path / "b", presses=7)  # a file that was begun is completed
    run(tmp_path / "c", presses=7)
    assert content(tmp_path / "b") == content(tmp_path / "c")
    assert content(tmp_path / "c")["A/A_0000.npy"][:2] == two["A/A_0000.npy"]


def test_more_letters_add_to_those_there(tmp_path):
    run(tmp_path, letters="A")
    reports = run(tmp_path, letters=["A", "B"])
    assert [(report.letter, report.kept) for report in reports] == [("A", True), ("B", False)]


def test_run_goes_on_where_files_are_missing(tmp_path, small_blocks):
    run(tmp_path, presses=7)
    before = content(tmp_path)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.npy")}
    gone = tmp_path / "Z" / "Z_0003.npy"
    gone.unlink()
    (tmp_path / "A" / ".A_0003.npy.0.tmp").write_bytes(b"begun")
    reports = run(tmp_path, presses=7)
    assert [report.path for report in reports if not report.kept] == [gone]
    assert sum(report.presses for report in reports) == 14
    assert content(tmp_path) == before
    assert {path: path.stat().st_mtime_ns for path in times if path != gone} == {
        path: stamp for path, stamp in times.items() if path != gone
    }
    assert not list(tmp_path.rglob(".*"))


def test_stopped_run_keeps_what_tells_how_it_was_made(tmp_path, small_blocks):
    running = simulate_letters(tmp_path, 7, letters="A")
    next(running)
    running.close()
    assert names(tmp_path) == ["A/A_0000.npy", "simulation.json"]
    with pytest.raises(ValueError, match="another 'seed'"):
        run(tmp_path, presses=7, seed=1)
    assert [report.kept for report in run(tmp_path, presses=7, letters="A")] == [True, False, False]


def test_other_layout_lies_beside_its_presses(tmp_path):
    layout = thinned()
    run(tmp_path, layout=layout)
    assert names(tmp_path) == ["A/A_0000.npy", "Z/Z_0000.npy", "layout.json", "simulation.json"]
    assert np.load(tmp_path / "A" / "A_0000.npy").shape == (2, 512)
    stored = TaxelLayout.load(tmp_path / "layout.json")
    assert torch.equal(stored.pos, layout.pos)
    assert torch.equal(stored.image_map, layout.image_map)
    assert all(report.kept for report in run(tmp_path, layout=layout))


def test_letter_array_by_hand_is_the_default(tmp_path):
    run(tmp_path / "a", layout=letter_array())
    run(tmp_path / "b")
    assert names(tmp_path / "a") == names(tmp_path / "b")
    assert content(tmp_path / "a") == content(tmp_path / "b")


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (
            {},
            {"seed": 1},
            r"simulation.json': the presses .* with another 'seed' \(0, not 1\)",
        ),
        ({}, {"press": LetterPress(bits=10)}, r"with another 'bits' \(8, not 10\); choose another"),
        (
            {},
            {"press": LetterPress(size=(0.01, 0.02))},
            r"another 'size' \(\[0.014, 0.02\], not",
        ),
        ({}, {"layout": thinned()}, r"with another 'layout' \(letter_array, not thin\)"),
        ({"layout": thinned()}, {}, r"with another 'layout' \(thin, not letter_array\)"),
        ({"presses": 5}, {"presses": 2}, "A_0000.npy' holds more presses than 'presses' requests"),
        ({"presses": 5}, {"presses": 3}, "A_0003.npy' holds more presses than 'presses' requests"),
    ],
    ids=["seed", "bits", "size", "layout", "default_layout", "begun", "files"],
)
def test_folder_of_other_presses(tmp_path, small_blocks, first, second, message):
    run(tmp_path, **first)
    before = content(tmp_path)
    with pytest.raises(ValueError, match=message):
        run(tmp_path, **second)
    assert content(tmp_path) == before


def test_folder_of_another_layout_with_its_name(tmp_path):
    layout = thinned()
    run(tmp_path, layout=layout)
    moved = TaxelLayout("thin", layout.pos + 0.001, image_map=layout.image_map)
    with pytest.raises(
        ValueError, match=r"layout.json', the layout of .* must have the same taxels"
    ):
        run(tmp_path, layout=moved)
    unmapped = TaxelLayout("thin", layout.pos)
    with pytest.raises(
        ValueError, match=r"layout.json', the layout of .* must have the same taxels"
    ):
        run(tmp_path, layout=unmapped)


def test_folder_of_other_things(tmp_path):
    run(tmp_path)
    (tmp_path / "simulation.json").unlink()
    with pytest.raises(ValueError, match=r"A_0000.npy' lies in a folder without 'simulation.json'"):
        run(tmp_path)
    (tmp_path / "simulation.json").write_text('{"synthetic": true, "generator": "bigs"}')
    with pytest.raises(ValueError, match=r"another 'generator' \(bigs, not letters\)"):
        run(tmp_path)
    (tmp_path / "simulation.json").write_text("[]")
    with pytest.raises(ValueError, match=r"another 'synthetic' \(None, not True\)"):
        run(tmp_path)
    (tmp_path / "simulation.json").write_text("{")
    with pytest.raises(ValueError, match=r"simulation.json' is damaged .* choose another folder"):
        run(tmp_path)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:-5]), "is damaged .*; delete it to sim"),
        (lambda path: path.write_bytes(b""), "is damaged .*; delete it to sim"),
        (lambda path: path.write_bytes(b"no array"), "is damaged .*; delete it to sim"),
        (
            lambda path: np.save(path, np.zeros((2, 32, 32))),
            "must hold float32 of .* float64",
        ),
        (lambda path: np.save(path, np.zeros((2, 1024), "f4")), r"\(got float32 of shape \(2, 102"),
        (lambda path: np.save(path, np.zeros((0, 32, 32), "f4")), r"of shape \(0, 32, 32\)\); del"),
        (lambda path: np.save(path, np.array([{}])), "is damaged .*; delete it to sim"),
    ],
    ids=["cut", "empty", "no_array", "double", "flat", "none", "pickle"],
)
def test_damaged_file_is_named(tmp_path, damage, message):
    run(tmp_path)
    damage(tmp_path / "Z" / "Z_0000.npy")
    with pytest.raises(ValueError, match=f"Z_0000.npy' .*{message}"):
        run(tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"presses": 0}, r"'presses' must be at least 1 \(got 0\)"),
        ({"jobs": 0}, r"'jobs' must be at least 1 \(got 0\)"),
        ({"seed": -1}, r"'seed' must not be negative \(got -1\)"),
        ({"press": {"bits": 8}}, r"'press' must be a LetterPress \(got \{'bits': 8\}\)"),
        ({"letters": ""}, r"'letters' must be one or more different letters \(got ''\)"),
        ({"letters": "ABA"}, r"'letters' must be one or more different letters \(got 'ABA'\)"),
        ({"letters": "Ab"}, r"'letter' must be one of the capital letters A to Z \(got 'b'\)"),
        ({"layout": grid(8, 8, 0.00125)}, "'layout' must have room for letters"),
        ({"press": LetterPress(dead_rows=40)}, "'dead_rows' must be at most the number of rows"),
    ],
    ids=["presses", "jobs", "seed", "press", "none", "twice", "small", "layout", "rows"],
)
def test_wrong_arguments_are_told_at_once(tmp_path, arguments, message):
    with pytest.raises(ValueError, match=message):
        simulate_letters(tmp_path / "a", **arguments)
    assert not (tmp_path / "a").exists()


@pytest.mark.full
def test_no_extra_is_needed(tmp_path):
    code = f"""
    import sys

    for name in ("mujoco", "h5py", "lightning", "matplotlib", "PIL", "cv2", "mahotas"):
        sys.modules[name] = None  # importing it fails
    from torch_geometric_tactile.sim import simulate_letters

    print(len(list(simulate_letters({str(tmp_path)!r}, 1))))
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=False
    )
    assert done.stdout == "26\n", done.stderr


def test_data_set_reads_what_was_simulated(tmp_path):
    from torch_geometric_tactile.datasets import LetterShape

    list(simulate_letters(tmp_path / "grid", 2))
    dataset = LetterShape(tmp_path / "grid", copies=1)
    assert (len(dataset), dataset.class_names) == (52, list(LETTERS))
    assert not dataset.left_out
    last = np.load(tmp_path / "grid" / "Z" / "Z_0000.npy")[1]
    assert dataset[51].x[:, 0].numpy() == pytest.approx(last.ravel() / 100)
    layout = thinned()
    list(simulate_letters(tmp_path / "thin", 1, layout=layout))
    dataset = LetterShape(tmp_path / "thin", copies=1, adjacency=None)
    assert dataset[0].x.shape == (512, 1)
    assert torch.equal(dataset.layout.pos, layout.pos)
