import math

import numpy as np
import pytest

from torch_geometric_tactile.data import Annotation, Recording
from torch_geometric_tactile.data._annotations import annotation_of_frames


def recording(annotations=(), num_frames=11):
    return Recording(
        np.arange(num_frames) / 10, np.zeros((num_frames, 4, 1)), annotations=annotations
    )


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
        ({}, "must be a sequence of .start, end, label. .got dict"),
        ([(0, 1)], r"a start, an end and a label each \(got \(0, 1\)\)"),
        (["abc"], "a start, an end and a label each"),
        ([(1, 0.5, "a")], r"an end that is not before it, in seconds \(got \(1, 0.5, 'a'\)\)"),
        ([(0, math.nan, "a")], "finite start"),
        ([(-math.inf, 0, "a")], "finite start"),
        ([(0, 10**400, "a")], "finite start"),
        ([("0", "1", "a")], "finite start"),
        ([(0, 1, "")], "labels of 1 to 255 printable characters"),
        ([(0, 1, " a")], "without blanks at the ends"),
        ([(0, 1, "a\nb")], "printable"),
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
