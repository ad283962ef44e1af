import numpy as np
import pytest
import torch

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch.nn.functional import cross_entropy

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.data import Recording, Windows
from torch_geometric_tactile.datasets import RecordingFrames
from torch_geometric_tactile.nn import TactileFNN
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import ZScore
from torch_geometric_tactile.visualization import plot_predictions, save_figure
from torch_geometric_tactile.visualization._predicted_trial import thin_codes, thin_steps

LAYOUT = grid(2, 2, pitch=0.01)
NAN = float("nan")
LONG = [f"a_wooden_object_of_the_kitchen_with_number_{i:02d}" for i in range(25)]


def predictor(names=("soft", "hard"), task="multiclass", **kwargs):
    torch.manual_seed(0)
    model = TactileFNN(4, len(names), channels={"tactile": 1}, widths=(5,), pools=(1,))
    return Predictor(model, LAYOUT, class_names=names, task=task, num_channels=1, **kwargs)


def recording(num_frames=40, **kwargs):
    tactile = np.zeros((num_frames, 4, 1))
    tactile[20:30, :2] = 50.0
    return Recording(7 + np.arange(num_frames) / 10, tactile, **kwargs)


def rows(*values, repeat=40):
    return torch.tensor(values).repeat(repeat, 1)


def steps(ax):
    """The values of each line of steps, and their edges."""
    return [patch.get_data()[:2] for patch in ax.patches if hasattr(patch, "get_data")]


def legend(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def lanes(ax):
    return [text.get_text() for text in ax.get_yticklabels()]


def names(ax):
    return [text.get_text() for text in ax.texts]


@pytest.fixture(scope="module")
def trained():
    """A model of frames and one of windows that tell a pressed pad from a free one."""
    draw, made = np.random.default_rng(0), []
    trials = []
    for i in range(6):
        x = draw.normal(0, 1, (40, 4, 1))
        held = np.where(np.arange(40) >= 15 + i, "held", "free")
        x[15 + i :] += 20
        trials.append(Recording(np.arange(40) / 20, x, privileged={"state": held}))
    frames = RecordingFrames(layout=LAYOUT, recordings=trials, target="state")
    for dataset in (frames, Windows(frames, 5, 4)):
        scaler = ZScore().fit(dataset.data)
        data = scaler(dataset.batch(range(len(dataset))))
        torch.manual_seed(0)
        model = TactileFNN(4, 2, channels={"tactile": data.x.size(-1)}, widths=(8,), pools=(1,))
        optimizer = torch.optim.Adam(model.parameters(), 0.02)
        for _ in range(80):
            optimizer.zero_grad()
            cross_entropy(model(data.x, None), data.y).backward()
            optimizer.step()
        made.append(Predictor.from_dataset(model, dataset, scaler))
    return made, trials


def test_trained_model_of_frames_is_drawn_with_its_truth(trained):
    (of_frames, _), trials = trained
    figure = plot_predictions(of_frames, trials[0])
    chances, bands, contact, total = figure.axes
    expected = of_frames.recording(trials[0])
    for i, (value, edges) in enumerate(steps(chances)):
        assert value == pytest.approx(expected[:, i].numpy())
        assert edges[0] == pytest.approx(-0.025)
        assert edges[-1] == pytest.approx(1.975)
    assert legend(chances) == ["free", "held"]
    assert lanes(bands) == ["predicted", "true (state)"]
    assert names(bands) == ["free", "held"] * 2
    right = np.mean([p[0] for p in of_frames.labels(expected)] == trials[0].privileged["state"])
    assert right > 0.9
    assert figure.get_suptitle() == f"40 frames, 1.95 s  |  {100 * right:.1f}\xa0%\xa0correct"
    assert steps(contact)[0][0].tolist() == [0] * 15 + [4] * 25
    assert total.get_ylabel() == "total pressure\n(unit unknown)"
    assert total.get_xlabel() == "time since the first frame (s)"


def test_answer_of_a_window_stands_from_its_last_frame(trained):
    (_, of_windows), trials = trained
    chances = plot_predictions(of_windows, trials[0]).axes[0]
    (value, edges), _ = steps(chances)
    last = of_windows.windows(trials[0])[1]
    assert last.tolist()[:2] == [4, 8]
    assert edges[:-1] == pytest.approx(trials[0].time[last])
    assert value == pytest.approx(of_windows.recording(trials[0])[:, 0].numpy())
    assert 1.95 < edges[-1] <= edges[-2] + 0.2


def test_one_answer_of_a_trial_is_seen_at_its_end():
    figure = plot_predictions(predictor(), recording(), rows(0.1, 0.9, repeat=1), frames=[39])
    value, edges = steps(figure.axes[0])[0]
    assert value == pytest.approx([0.1])
    assert edges == pytest.approx([3.9, 3.9 + 0.03 * 4.0])
    assert figure.axes[0].get_xlim()[1] == pytest.approx(edges[1])


def test_missing_answers_are_gaps():
    probability = rows(0.2, 0.8)
    probability[5:9] = NAN
    chances, bands, *_ = plot_predictions(predictor(), recording(), probability).axes
    assert np.isnan(steps(chances)[0][0]).nonzero()[0].tolist() == [5, 6, 7, 8]
    assert [c.get_paths()[0].get_extents().x0 for c in bands.collections] == pytest.approx(
        [-0.05, 0.85]
    )


def test_touch_by_hand():
    figure = plot_predictions(predictor(), recording(meta={"unit": "count"}), rows(0.2, 0.8))
    *_, contact, total = figure.axes
    assert steps(contact)[0][0].tolist() == [0] * 20 + [2] * 10 + [0] * 10
    assert steps(total)[0][0].tolist() == [0] * 20 + [100] * 10 + [0] * 10
    assert total.get_ylabel() == "total pressure\n(counts)"
    three = np.zeros((40, 4, 3))
    three[20:, 0] = (3.0, 0.0, 4.0)  # counts, not beyond the floor
    rec = Recording(np.arange(40) / 10, three, meta={"unit": "count"})
    *_, contact, total = plot_predictions(predictor(), rec, rows(0.2, 0.8)).axes
    assert steps(total)[0][0].tolist() == [0] * 20 + [5] * 20
    assert not steps(contact)[0][0].any()
    three = Recording(rec.time, three, meta={"unit": "newton"})
    *_, contact, _ = plot_predictions(predictor(), three, rows(0.2, 0.8)).axes
    assert steps(contact)[0][0].tolist() == [0] * 20 + [1] * 20


SLIP = (np.arange(40) > 20).astype(int)


@pytest.mark.parametrize(
    ("classes", "kwargs", "source", "found"),
    [
        (("soft", "hard"), {"label": "hard"}, "label", ["hard"]),
        (("3", "7"), {"label": 7}, "label", ["7"]),
        (("soft", "hard"), {"meta": {"object": "soft"}}, "object", ["soft"]),
        (("hold", "slip"), {"privileged": {"slip": SLIP}}, "slip", ["hold", "slip"]),
        (
            ("hover", "lift"),
            {"privileged": {"phase": SLIP}, "meta": {"phase_names": ["hover", "lift"]}},
            "phase",
            ["hover", "lift"],
        ),
        (("0", "1"), {"privileged": {"grasp": SLIP}}, "grasp", ["0", "1"]),
        (("0", "1"), {"privileged": {"phase": SLIP}, "meta": {"seed": 1}}, None, []),
        (("soft", "hard"), {"label": "mug"}, None, []),
        (
            ("hold", "slip"),
            {"privileged": {"phase": SLIP, "slip": SLIP}, "meta": {"phase_names": ["up", "hold"]}},
            "slip",
            ["hold", "slip"],
        ),
    ],
)  # fmt: skip
def test_truth_is_found_in_the_recording(classes, kwargs, source, found):
    figure = plot_predictions(predictor(classes), recording(**kwargs), rows(0.2, 0.8))
    bands = figure.axes[1]
    assert lanes(bands) == ["predicted", *([f"true ({source})"] if source else [])]
    assert names(bands) == [classes[1], *found]
    assert ("correct" in figure.get_suptitle()) == (source is not None)


def test_given_truth_goes_before_that_of_the_recording():
    truth = ["soft"] * 10 + [""] * 20 + ["hard"] * 10
    figure = plot_predictions(predictor(), recording(label="soft"), rows(0.2, 0.8), truth=truth)
    assert lanes(figure.axes[1]) == ["predicted", "true (given)"]
    assert names(figure.axes[1]) == ["hard", "soft", "hard"]
    assert "50.0\xa0%\xa0correct" in figure.get_suptitle()


def test_many_classes_leave_those_that_were_predicted_or_true():
    probability = torch.full((40, 25), 0.01)
    probability[:20, 3], probability[20:, 9] = 0.76, 0.76
    figure = plot_predictions(predictor(LONG), recording(label=LONG[17]), probability)
    assert legend(figure.axes[0])[:1] == ["a_wooden_object...\nhen_with_number_03"]
    assert [text[-2:] for text in legend(figure.axes[0])[:3]] == ["03", "09", "17"]
    assert legend(figure.axes[0])[3] == "22 others,\ntogether"
    assert steps(figure.axes[0])[3][0] == pytest.approx(22 * 0.01)


def test_labels_have_bands_with_their_truth():
    probability = rows(0.9, 0.2, 0.6)
    probability[:20, 1] = 0.8
    meta = {"label_names": ["slippery", "hard"], "labels": [0, 1]}
    made = predictor(("hard", "slippery", "tall"), "multilabel")
    figure = plot_predictions(made, recording(meta=meta), probability)
    chances, bands, *_ = figure.axes
    assert legend(chances) == lanes(bands) == ["hard", "slippery", "tall"]
    spans = [[p.get_extents().x1 for p in c.get_paths()] for c in bands.collections]
    assert spans == [pytest.approx(x) for x in ([3.95], [3.95], [1.95], [], [3.95], [])]
    assert legend(bands) == ["thin: true\n(labels)"]


def test_numbers_have_their_true_ones_beside():
    force = np.arange(40.0)
    made = predictor(("force", "width"), "regression")
    rec = recording(extra={"force": force}, meta={"width": 0.5})
    figure = plot_predictions(made, rec, torch.tensor(np.stack([force + 1, force], axis=1)))
    ax, contact, _ = figure.axes
    assert contact.get_ylabel() == "taxels in\ncontact"
    true, width, first, second = (value for value, _ in steps(ax))
    assert true.tolist() == force.tolist()
    assert set(width) == {0.5}
    assert first.tolist() == (force + 1).tolist()
    assert second.tolist() == force.tolist()
    assert legend(ax) == ["force", "width", "pale: true"]
    made, many = predictor(LONG, "regression"), torch.zeros(40, 25)
    many[0, 4:11] = 1.0
    ax = plot_predictions(made, recording(), many).axes[0]
    assert [text[-2:] for text in legend(ax)[:7]] == ["04", "05", "06", "07", "08", "09", "10"]
    assert legend(ax)[7] == "18 more not drawn"


def test_thinning_keeps_the_extremes_and_the_most_frequent():
    draw = np.random.default_rng(0)
    value, edges = draw.normal(size=(20_001, 2)), np.arange(20_002.0)
    value[12_345] = 9, -9
    value[:1000] = NAN
    thin_edges, thin = thin_steps(edges, value)
    assert len(thin) <= 3000
    assert len(thin_edges) == len(thin) + 1
    assert thin[:, 0].max(initial=0, where=~np.isnan(thin[:, 0])) == 9
    assert np.nanmin(thin[:, 1]) == -9
    assert (thin_edges[0], thin_edges[-1]) == (0, 20_001)
    assert (np.diff(thin_edges) > 0).all()
    gap = np.isnan(thin[:, 0])
    assert gap[:100].all()
    assert not gap[200:].any()
    code = np.where(np.arange(20_001) < 10_000, 1, 2)
    code[::3] = -1
    thin_edges, most = thin_codes(edges, code)
    assert set(most[:700]) == {1}
    assert set(most[-700:]) == {2}
    assert len(thin_edges) == len(most) + 1 <= 1501


@pytest.mark.parametrize(
    ("rec", "probability", "frames"),
    [
        (recording(1, label="soft"), rows(0.2, 0.8, repeat=1), None),
        (recording(2), rows(0.2, 0.8, repeat=2), None),
        (recording(), torch.zeros(0, 2), []),
        (recording(), rows(NAN, NAN), None),
        (recording(5000, label="hard"), rows(0.2, 0.8, repeat=5000), None),
        (Recording([0.0, 1.0], np.full((2, 4, 1), NAN)), rows(NAN, NAN, repeat=2), None),
        (recording(label="$5 \n mug", meta={"sensor": "x" * 200}), rows(0.2, 0.8), None),
    ],
)
@pytest.mark.parametrize("task", ["multiclass", "multilabel", "regression"])
def test_unusual_sizes_can_be_saved(rec, probability, frames, task, tmp_path):
    made = predictor(("soft", "$5 \n mug"), task)
    save_figure(plot_predictions(made, rec, probability, frames), tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("task", ["multiclass", "multilabel", "regression"])
@pytest.mark.parametrize("values", [torch.zeros(0, 25), torch.full((40, 25), NAN)])
def test_many_outputs_without_answers_can_be_saved(task, values, tmp_path):
    frames = range(len(values))
    save_figure(
        plot_predictions(predictor(LONG, task), recording(), values, frames), tmp_path / "a.png"
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"probability": rows(0.2, 0.8, repeat=3)}, "a row for each of the 40 'frames' .got .3, 2"),
        ({"probability": torch.zeros(40)}, "must have shape .num_answers, num_classes"),
        ({"probability": rows(0.2, 0.3, 0.5)}, "'class_names' must have 3 names"),
        ({"probability": rows(0.2, 0.8, repeat=1), "frames": [40]}, "whole numbers from 0 to 39"),
        ({"probability": rows(0.2, 0.8, repeat=2), "frames": [3, 3]}, "must be increasing"),
        ({"truth": ["soft"]}, "'truth' must be the name of a class for each of the 40 frames"),
        ({"truth": np.zeros(40)}, "frames .got float64 of shape .40"),
    ],
)
def test_wrong_input_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        plot_predictions(predictor(), recording(), **given)


def test_recording_must_have_frames_and_fit():
    with pytest.raises(ValueError, match="'recording' must hold at least one frame"):
        plot_predictions(predictor(), recording(0))
    with pytest.raises(ValueError, match="must have 4 taxels"):
        plot_predictions(predictor(), Recording([0.0], np.zeros((1, 3, 1))))
    made = predictor(task="multilabel")
    with pytest.raises(ValueError, match=r"'truth' must be numbers of shape \(40, 2\)"):
        plot_predictions(made, recording(), rows(0.2, 0.8), truth=np.zeros((40, 3)))


def test_annotations_are_the_truth_where_their_labels_are_classes():
    spans = [(8, 9, "soft"), (9, 10, "hard")]
    probability = rows([0.9, 0.1])
    figure = plot_predictions(predictor(), recording(annotations=spans), probability)
    assert lanes(figure.axes[1]) == ["predicted", "true (annotations)"]
    assert len(figure.axes) == 4  # and no lanes of their own
    # Ten frames from 8 s on are soft, eleven from 9 s to 10 s hard; nothing is known of others.
    assert figure.get_suptitle().endswith("47.6\xa0%\xa0correct")
    model = predictor(("soft", "hard", "none"))
    figure = plot_predictions(model, recording(annotations=spans), rows([0.1, 0.1, 0.8]))
    assert figure.get_suptitle().endswith("47.5\xa0%\xa0correct")  # 19 of 40 frames are "none"


def test_other_annotations_have_lanes_in_the_colours_of_their_classes():
    spans = [(8, 9, "grip"), (8.5, 10, "hard")]
    figure = plot_predictions(predictor(), recording(annotations=spans), rows([0.9, 0.1]))
    assert lanes(figure.axes[1]) == ["predicted"]
    ax = figure.axes[2]
    assert lanes(ax) == ["grip", "hard"]
    hard = figure.axes[0].patches[1].get_edgecolor()
    assert tuple(ax.collections[1].get_facecolor()[0]) == hard
    assert tuple(ax.collections[0].get_facecolor()[0]) != hard
    regression = predictor(("soft", "hard"), task="regression")
    figure = plot_predictions(regression, recording(annotations=spans), rows([0.9, 0.1]))
    assert lanes(figure.axes[1]) == ["grip", "hard"]


def test_time_without_frames_is_no_class():
    spans = [(9.2, 9.4, "gap")]
    figure = plot_predictions(
        predictor(("soft", "gap")), recording(annotations=spans), rows([1, 0])
    )
    assert lanes(figure.axes[1]) == ["predicted"]
    spans = [(8, 9, "soft"), (9, 10, "hard"), (8.5, 9.5, "gap")]
    figure = plot_predictions(predictor(), recording(annotations=spans), rows([0.9, 0.1]))
    assert lanes(figure.axes[1]) == ["predicted", "true (annotations)"]
    assert figure.get_suptitle().endswith("47.6\xa0%\xa0correct")


def test_annotations_that_overlap_are_no_truth():
    spans = [(8, 9, "soft"), (8.5, 10, "hard")]
    figure = plot_predictions(predictor(), recording(annotations=spans), rows([0.9, 0.1]))
    assert lanes(figure.axes[1]) == ["predicted"]
    assert lanes(figure.axes[2]) == ["soft", "hard"]
