import math

import numpy as np
import pytest
from recordings import counting_recording

from torch_geometric_tactile.data import Annotation
from torch_geometric_tactile.data._annotations import annotation_of_frames, annotations_within


def recording(annotations=(), num_frames=11):
    return counting_recording(num_frames, rate=10, annotations=annotations)


def test_annotations_are_values_in_the_order_of_their_starts():
    found = recording([(0.5, 0.6, "slip"), [np.float32(0.25), 1, "hold"], Annotation(-3, 2.5, "é")])
    assert found.annotations == ((-3.0, 2.5, "é"), (0.25, 1.0, "hold"), (0.5, 0.6, "slip"))
    assert found.annotations[0].label == "é"
    assert {type(a.start) for a in found.annotations} == {float}
    assert repr(found).endswith("rate=10, annotations=3)")


def test_without_annotations_nothing_is_said_of_them():
    assert recording().annotations == ()
    assert repr(recording()) == "Recording(num_frames=11, num_taxels=4, num_channels=1, rate=10)"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (3, "must be a sequence of .start, end, label. .got int"),
        ("slip", "must be a sequence of .start, end, label. .got str"),
        ([(0, 1)], r"must each have a start, an end and a label \(got \(0, 1\)\)"),
        ([(1, 0.5, "a")], r"an end not before the start, in seconds \(got \(1, 0.5, 'a'\)\)"),
        ([(-math.inf, 0, "a")], "finite start"),
        ([(0, 10**400, "a")], "finite start"),
        ([("0", "1", "a")], "finite start"),
        ([(0, 1, "")], "labels of 1 to 255 printable characters"),
        ([(0, 1, " a")], "without blanks at the ends"),
        ([(0, 1, "a" * 256)], "labels of 1 to 255"),
        ([(0, 1, "\ud800")], "printable"),
        ([(0, 1, 3)], r"\(got 3\)"),
        ([(0, 1, "a")] * 10_001, r"at most 10000 in one recording \(got 10001\)"),
    ],
)
def test_what_is_no_annotation_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        recording(wrong)


def test_select_keeps_those_that_overlap_cut_to_what_is_kept():
    whole = recording([(-1, 0.25, "a"), (0.3, 0.4, "b"), (0.45, 9, "c"), (0.7, 0.8, "d")])
    assert whole.select(slice(2, 6)).annotations == (
        (0.2, 0.25, "a"),
        (0.3, 0.4, "b"),
        (0.45, 0.5, "c"),
    )
    assert whole.select(slice(3, 9, 2)).annotations[-1] == (0.7, 0.7, "d")
    assert whole.select(slice(0, 0)).annotations == ()


def test_a_frame_has_the_label_of_what_covers_it():
    annotations = recording([(0.2, 0.4, "a"), (0.4, 0.6, "b"), (0.8, 0.8, "c")]).annotations
    found = annotation_of_frames(annotations, np.arange(11) / 10)
    # A frame on which one ends and the next begins is of the next.
    assert "".join(label[0] for label in found) == "nnaabbbncnn"
    assert found[0] == "none"
    assert annotation_of_frames((), np.arange(2.0)).tolist() == ["none", "none"]


def test_overlap_is_allowed_of_one_label_only():
    time = np.arange(11) / 10
    same = recording([(0.1, 0.5, "a"), (0.3, 0.7, "a")]).annotations
    assert (annotation_of_frames(same, time) == "a").sum() == 7
    between_frames = recording([(0.1, 0.27, "a"), (0.25, 0.7, "b")]).annotations
    assert (annotation_of_frames(between_frames, time) == "b").sum() == 5
    other = recording([(0.1, 0.5, "a"), (0.3, 0.7, "b")]).annotations
    with pytest.raises(ValueError, match=r"got 'a' and 'b' in frame 3, at 0.3 s"):
        annotation_of_frames(other, time)
    inside = recording([(0.1, 0.9, "a"), (0.3, 0.4, "a"), (0.6, 0.7, "b")]).annotations
    with pytest.raises(ValueError, match="in frame 6"):
        annotation_of_frames(inside, time)


def span_ends(i, rate, times):
    """How people write the time of a frame."""
    yield i / rate
    yield i * (1 / rate)
    yield float(np.arange(i + 1)[-1] * np.float64(1 / rate))
    yield float(np.cumsum(np.full(i + 1, 1 / rate))[-1] - 1 / rate)
    yield float(times[i] - times[0])
    # Texts whose last digit is a small part of a frame.
    yield from (round(i / rate, d) for d in range(2, 7) if 10**-d * rate <= 0.08)


@pytest.mark.parametrize("offset", [0.0, 1_704_276_000.0, 1_704_276_000.123])
def test_a_span_from_frame_to_frame_is_these_frames_however_they_are_written(offset):
    draw = np.random.default_rng(0)
    for rate in [100, 30, 7, *draw.uniform(1, 1000, 6)]:
        clocks = [np.arange(200) / rate, np.arange(200) * (1 / rate), np.arange(0, 199.5) / rate]
        for time in (offset + clock for clock in clocks):
            i, j = sorted(draw.integers(1, 199, 2).tolist())
            for start in span_ends(i, rate, time):
                for end in span_ends(j, rate, time):
                    start, end = min(start, end), max(start, end)
                    spans = [Annotation(offset + start, offset + end, "slip")]
                    inside = np.flatnonzero(annotation_of_frames(spans, time) == "slip")
                    assert inside.tolist() == [*range(i, j + 1)], (rate, start, end)
                    (within,) = annotations_within(spans, time)
                    assert within.start <= within.end
                    assert annotation_of_frames([within], time).tolist().count("slip") == j - i + 1
                    # Ends that lie in the frames that are kept stay there.
                    assert annotations_within(spans, time[: i + 1]), (rate, start)
                    assert annotations_within(spans, time[j:]), (rate, end)


def test_a_frame_where_one_ends_and_the_next_begins_but_for_rounding_is_of_the_next():
    time = np.arange(100) * 0.01
    for error in (0, 1e-16, -1e-16, 1e-6, -1e-6):
        spans = [Annotation(0.3, 0.57 + error, "a"), Annotation(0.57, 0.7 + error, "b")]
        labels = annotation_of_frames([*spans, Annotation(0.7, 0.8, "c")], time)
        assert (labels == "a").nonzero()[0].tolist() == [*range(30, 57)]
        assert (labels == "b").nonzero()[0].tolist() == [*range(57, 70)]
        assert (labels == "c").nonzero()[0].tolist() == [*range(70, 81)]


def test_ends_that_are_more_than_rounding_away_from_a_frame_do_not_take_it():
    labels = annotation_of_frames([Annotation(0.302, 0.568, "a")], np.arange(100) * 0.01)
    assert (labels == "a").nonzero()[0].tolist() == [*range(31, 57)]
    # Of frames that came in a burst, each is by itself.
    burst = np.array([0, 1e-6, 2e-6, 0.016, 0.016001, 0.016002])
    labels = annotation_of_frames([Annotation(1e-6, 0.016, "a")], burst)
    assert (labels == "a").nonzero()[0].tolist() == [1, 2, 3]
    labels = annotation_of_frames([Annotation(3.1, 3.2, "a")], np.array([3.1]))
    assert labels.tolist() == ["a"]


@pytest.mark.parametrize(
    "span", [(300, 570), (1_704_276_000.1, 1_704_276_000.4), (-2, -1), (1.01, 1.2)]
)
def test_a_span_outside_of_the_recording_is_refused(span):
    message = (
        rf"grasp_1.h5: the annotation 'slip' must be within .*, from 0.0 to 1.0 s \(got "
        rf"{float(span[0])!r} to {float(span[1])!r} s\): .* seconds on the clock of the recording"
    )
    annotations = recording([(0, 0.1, "hold"), (*span, "slip")]).annotations
    with pytest.raises(ValueError, match=message):
        annotation_of_frames(annotations, np.arange(11) / 10, "grasp_1.h5")


def test_a_span_without_a_frame_is_named_in_a_warning(caplog):
    time = np.delete(np.arange(11) / 10, [5, 6, 7])
    spans = recording([(0, 0.2, "a"), (0.23, 0.27, "b"), (0.45, 0.72, "c"), (0.8, 0.8, "d")])
    labels = annotation_of_frames(spans.annotations, time, "grasp_1.h5")
    assert labels.tolist() == ["a", "a", "a", "none", "none", "d", "none", "none"]
    assert [record.args for record in caplog.records] == [
        ("grasp_1.h5", "b", 0.23, 0.27),
        ("grasp_1.h5", "c", 0.45, 0.72),
    ]


def test_time_without_frames_labels_none(caplog):
    time = np.delete(np.arange(11) / 10, [5, 6, 7])
    spans = [(0.3, 0.8, "gap"), (0.2, 0.4, "a"), (0.8, 0.9, "b"), (40, 50, "gap")]
    labels = annotation_of_frames(recording(spans).annotations, time)
    assert labels.tolist() == ["none", "none", "a", "a", "a", "b", "b", "none"]
    assert not caplog.records
