import math

import numpy as np
import pytest

from torch_geometric_tactile.io._icub_grasp_txt import ICubGraspFrames, read_icub_grasp_txt

FINGERS = ("thumb", "index", "middle", "ring", "little")


def frame(first=0):
    """The lines of a frame: taxel k of finger i reads 240 - 12 i - k."""
    rows = [[240 - 12 * i - k for k in range(12)] for i in range(5)]
    encoders = " ".join(f"{10 * (first + i)}.5" for i in range(9)) + " "
    maxima = " ".join(f"{255 - min(row)}.0" for row in rows)
    return [encoders, maxima, *(" ".join(f"{cell}.0" for cell in row) for row in rows)]


@pytest.fixture
def write(tmp_path):
    """Writes lines as a file, and returns its path."""

    def write(*lines, end="\r\n", last=True):
        text = end.join(lines) + (end if last else "")
        (tmp_path / "cup_1.txt").write_bytes(text.encode())
        return tmp_path / "cup_1.txt"

    return write


def changed(line, text):
    lines = ["-10000", *frame(), *frame(1)]
    lines[line - 1] = text
    return lines


def test_read_by_hand(write):
    found = read_icub_grasp_txt(write("-10000", *frame(), *frame(1)))
    assert isinstance(found, ICubGraspFrames)
    assert found.reading.shape == (2, 60)
    assert found.reading[0].tolist() == [240.0 - i for i in range(60)]
    assert found.encoder.shape == (2, 9)
    assert found.encoder[0, 2] == pytest.approx(math.radians(20.5))
    assert found.encoder[1, 0] == pytest.approx(math.radians(10.5))
    assert found.maximum[1].tolist() == [26.0, 38.0, 50.0, 62.0, 74.0]
    assert {part.dtype for part in found} == {np.dtype(np.float32)}


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_read_single_frame_in_every_style(write, end):
    assert read_icub_grasp_txt(write("-10000", *frame(), end=end)).reading.shape == (1, 60)
    tabs = [line.strip().replace(" ", "\t") for line in frame()]
    assert read_icub_grasp_txt(write(" -10000 ", *tabs, end=end)).reading[0, 59] == 181.0


@pytest.mark.parametrize("head", ["10000", "", "-10_000"])
def test_read_other_first_line(write, head):
    with pytest.raises(ValueError, match=r"cup_1\.txt', line 1 must be -10000 \(got "):
        read_icub_grasp_txt(write(head, *frame()))


@pytest.mark.parametrize("lines", range(7))
def test_read_frame_that_is_not_whole(write, lines):
    kept = [*frame(), *frame()[:lines]] if lines else []
    with pytest.raises(
        ValueError, match=r"must hold 7 lines for each frame, .*: is the file truncated"
    ):
        read_icub_grasp_txt(write("-10000", *kept))


@pytest.mark.parametrize(
    ("line", "text", "message"),
    [
        (2, "1 2 3", r"line 2 must hold 9 numbers, encoders \(got 3\)"),
        (3, "1 2 3 4 5 6", r"line 3 must hold 5 numbers, maxima \(got 6\)"),
        (5, "", r"line 5 must hold 12 numbers, taxels of the index finger \(got 0\)"),
        (9, "1 2 3 4 5 6 7 8 x", r"line 9: encoders must be finite numbers \(got 'x'\)"),
        (2, "1 2 3 4 5 6 7 8 361", r"encoders must be between -360 and 360 degrees \(got 361\)"),
        (4, " ".join(["240.5"] * 12), r"thumb finger must be integers .* \(got 240.5\)"),
        (4, " ".join(["256"] * 12), r"thumb finger must be integers from 0 to 255 \(got 256"),
    ],
)
def test_read_bad_line_is_named(write, line, text, message):
    with pytest.raises(ValueError, match=rf"cup_1\.txt', {message}|cup_1.*{message}"):
        read_icub_grasp_txt(write(*changed(line, text)))


def test_read_maximum_may_be_a_little_older_than_the_readings(write):
    read_icub_grasp_txt(write(*changed(3, "20 32 56 62 74")))
    with pytest.raises(
        ValueError,
        match=r"line 4: taxels of the thumb finger must agree with the max.* 19, within 6",
    ):
        read_icub_grasp_txt(write(*changed(3, "19 38 50 62 74")))


def test_read_swapped_fingers_are_noticed(write):
    lines = ["-10000", *frame()]
    lines[3], lines[4] = lines[4], lines[3]
    with pytest.raises(ValueError, match="are lines out of order"):
        read_icub_grasp_txt(write(*lines))


def test_read_refuses_a_last_line_without_end(write):
    with pytest.raises(
        ValueError, match=r"line 8 must end with a line break .*: is the file truncated"
    ):
        read_icub_grasp_txt(write("-10000", *frame(), last=False))


def test_read_refuses_a_line_without_end_before_it_takes_memory(write):
    with pytest.raises(ValueError, match=r"line 2 must end with a line break after fewer than"):
        read_icub_grasp_txt(write("-10000", "1 " * 5000))


@pytest.mark.parametrize("text", ["1 2\x00", "\u0661 2 3 4 5 6 7 8 9", "1\x0b2 3 4 5 6 7 8 9"])
def test_read_what_is_no_plain_text(write, text):
    with pytest.raises(ValueError, match=r"line 2 must be plain text"):
        read_icub_grasp_txt(write(*changed(2, text)))


def test_published_files_are_read_whole(icub_root):
    frames = {p.stem: read_icub_grasp_txt(p) for p in sorted((icub_root / "raw").glob("*.txt"))}
    counts = [len(trial.reading) for trial in frames.values()]
    assert (len(frames), min(counts), max(counts), sum(counts)) == (230, 4, 24, 2883)
    reading = np.concatenate([trial.reading for trial in frames.values()])
    assert (reading.min(), reading.max()) == (142.0, 255.0)
    first = frames["full_coke_1"]
    assert first.reading[0, :3].tolist() == [239.0, 190.0, 214.0]
    assert first.reading[0, 48:51].tolist() == [243.0, 244.0, 248.0]
    assert np.rad2deg(first.encoder[0, :2]).tolist() == pytest.approx([21.0, 81.2898], rel=1e-5)
    assert first.maximum[0].tolist() == [66.0, 15.0, 11.0, 13.0, 12.0]
