import copy

import numpy as np
import pytest
import torch
from torch_geometric.transforms import Compose

from torch_geometric_tactile.data import (
    Recording,
    StaticData,
    StaticDataset,
    Trials,
    Windows,
    join_frames,
)
from torch_geometric_tactile.nn.models import GraspGCN, TemporalTaxelNet
from torch_geometric_tactile.predictor import Predictor, _content
from torch_geometric_tactile.predictor._window_cut import WindowCut, apply_to_frames
from torch_geometric_tactile.sensors import biotac
from torch_geometric_tactile.transforms import (
    CommonMode,
    ContactCrop,
    KNNGraph,
    Resample,
    SessionZScore,
    Tare,
    ZScore,
    fit_transform,
)

LENGTHS = (50, 64, 57, 70)


def frames(transform=None, lengths=LENGTHS):
    rng = np.random.default_rng(0)
    x, trial, time = [], [], []
    for i, length in enumerate(lengths):
        one = rng.normal(0.0, 0.5, (length, 19, 3))
        one[15 + i :] += np.linspace(0, 100, length - 15 - i)[:, None, None] + 40
        x.append(one)
        trial += [i] * length
        time.append(np.arange(length) / 100)
    trial = torch.tensor(trial)
    return StaticDataset.from_arrays(
        torch.from_numpy(np.concatenate(x)).float(),
        trial % 2,
        trial=trial,
        session=trial % 2,
        time=torch.from_numpy(np.concatenate(time)),
        layout=biotac(),
        transform=transform,
    )


def trials(**arguments):
    steps = Compose([KNNGraph(2), ContactCrop(), Resample(60)])
    return Trials(frames(), ragged="pad", pre_transform=steps, **arguments)


def windows(length=20, hop=3, **arguments):
    return Windows(frames(), length, hop, label="trial", **arguments)


def recording(dataset, trial):
    source = dataset.dataset
    mask = source.column("trial") == trial
    return Recording(
        time=source.column("time")[mask].numpy(), tactile=source.column("x")[mask].numpy()
    )


def predictor_of(dataset, model, *steps):
    transform = Compose(list(steps))
    fit_transform(transform, dataset)
    return Predictor.from_dataset(model, dataset, transform), transform


def said_of(predictor, dataset):
    data = predictor.prepare_samples(dataset.batch(torch.arange(len(dataset))))
    with torch.no_grad():
        return predictor.probability(predictor.logits(data))


def again(predictor, tmp_path):
    predictor.save(tmp_path / "one.predictor")
    return Predictor.load(tmp_path / "one.predictor")


def test_whole_trials_are_cut_as_in_training(tmp_path):
    dataset = trials()
    predictor, _ = predictor_of(dataset, GraspGCN("biotac", in_channels=60), ZScore(per="signal"))
    expected = said_of(predictor, dataset)
    for one in (predictor, again(predictor, tmp_path)):
        assert one.window == WindowCut(max(LENGTHS), 0, "pad")
        for i in range(len(LENGTHS)):
            found = one.recording(recording(dataset, i))
            assert found.shape == (1, 2)
            torch.testing.assert_close(found[0], expected[i], atol=1e-5, rtol=1e-5)
            assert one.windows(recording(dataset, i))[1].tolist() == [LENGTHS[i] - 1]
    longer = trials().dataset.column("x")[:50].repeat(2, 1, 1)  # than any trial of the training
    long = Recording(time=np.arange(100) / 100, tactile=longer.numpy())
    assert predictor.recording(long).isfinite().all()


def test_windows_are_cut_as_in_training_whatever_the_batch(tmp_path):
    dataset = windows(pre_transform=KNNGraph(2))
    predictor, _ = predictor_of(dataset, GraspGCN("biotac", in_channels=20), ZScore(per="signal"))
    expected = said_of(predictor, dataset)
    of_trial = dataset.column("trial")
    for one in (predictor, again(predictor, tmp_path)):
        assert one.window == WindowCut(20, 3)
        for i in range(len(LENGTHS)):
            for size in (1, 256):
                found = one.recording(recording(dataset, i), batch_size=size)
                torch.testing.assert_close(found, expected[of_trial == i], atol=1e-5, rtol=1e-5)
        cut, last = one.windows(recording(dataset, 1))
        assert last.tolist() == list(range(19, 64, 3))
        # A window by hand, as FrameRing gives one.
        torch.testing.assert_close(one(cut.x[4]), expected[of_trial == 1][4], atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(one(cut.x), expected[of_trial == 1], atol=1e-5, rtol=1e-5)


def test_frames_go_through_their_own_transform_first(tmp_path):
    source = frames(transform=CommonMode())
    dataset = Windows(source, 20, 5, label="trial", pre_transform=KNNGraph(2))
    predictor, _ = predictor_of(dataset, GraspGCN("biotac", in_channels=20), ZScore(per="signal"))
    assert isinstance(predictor.preparation.frame_transform.transforms[0], CommonMode)
    expected = said_of(predictor, dataset)[dataset.column("trial") == 2]
    for one in (predictor, again(predictor, tmp_path)):
        found = one.recording(recording(dataset, 2))
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)
        raw = recording(dataset, 2).tactile[:20]
        window = join_frames(torch.from_numpy(raw.copy()).transpose(0, 1))
        torch.testing.assert_close(one(window), expected[0], atol=1e-5, rtol=1e-5)


def test_attributes_of_a_window_are_those_of_its_last_frame():
    def numbered(data):
        data.step = torch.arange(len(data.x))
        return data

    numbered.supports_static = True
    windows = StaticData(x=torch.rand(2, 5, 3), trial=torch.tensor([4, 7]), num_frames=3)
    found = apply_to_frames([numbered], windows)
    assert (found.trial.tolist(), found.step.tolist()) == ([4, 7], [2, 5])
    assert found.x.equal(windows.x)


def test_apply_to_frames_equals_windows():
    torch.manual_seed(0)
    model = TemporalTaxelNet("biotac", 2, in_channels=3, num_blocks=2, kernel_size=2)
    dataset = windows(length=model.receptive_field + 3, hop=1)
    predictor, transform = predictor_of(dataset, model, ZScore(per="signal"))
    one = recording(dataset, 1)
    expected = predictor.recording(one)
    (scaler,) = transform.transforms
    window = join_frames(torch.from_numpy(one.tactile).transpose(0, 1)).unsqueeze(0)
    data = predictor.preparation.readings_to_data(window)
    assert data.num_frames == 64
    x = scaler(data).x[0].view(19, 3, 64)
    state, said = predictor.model.initial_state(1), []
    with torch.no_grad():
        for t in range(64):
            logits, state = predictor.model.step(x[None, :, :, t], None, state)
            said.append(predictor.probability(logits)[0])
    said = torch.stack(said)[model.receptive_field + 2 :]
    torch.testing.assert_close(said, expected, atol=1e-5, rtol=1e-5)


def test_whether_an_answer_needs_frames_to_come_is_said_by_the_transforms():
    model = GraspGCN("biotac", in_channels=60)
    whole, _ = predictor_of(trials(), model, ZScore(per="signal"))
    live, _ = predictor_of(windows(length=60, pre_transform=KNNGraph(2)), model)
    assert (whole.causal, live.causal) == (False, True)


def test_number_of_frames_is_shared_and_kept(tmp_path):
    predictor, _ = predictor_of(trials(), GraspGCN("biotac", in_channels=60))
    for one in (predictor, again(predictor, tmp_path)):
        assert one.preparation.shared.num_frames == 60
        assert one.preparation.num_channels == 3
    assert copy.deepcopy(predictor).preparation.shared.num_frames == 60


def test_windows_adapt_to_a_session():
    dataset = windows(pre_transform=KNNGraph(2))
    predictor, _ = predictor_of(dataset, GraspGCN("biotac", in_channels=20), SessionZScore())
    one = recording(dataset, 0)
    number = predictor.adapt_windows(predictor.windows(one)[0])
    assert number == 2
    assert predictor.recording(one).isfinite().all()
    plain, _ = predictor_of(dataset, GraspGCN("biotac", in_channels=20))
    with pytest.raises(ValueError, match="no transform of this predictor measures sessions"):
        plain.adapt_windows(plain.windows(one)[0])


def test_bad_recordings():
    dataset = windows(pre_transform=KNNGraph(2))
    predictor, _ = predictor_of(dataset, GraspGCN("biotac", in_channels=20))
    short = recording(dataset, 0).select(slice(0, 19))
    with pytest.raises(ValueError, match=r"at least 20 frames, .* \(got 19\)"):
        predictor.recording(short)
    with pytest.raises(ValueError, match=r"at least one frame to predict \(got none\)"):
        predictor.recording(short.select(slice(0, 0)))
    with pytest.raises(ValueError, match=r"'batch_size' must be at least 1 \(got 0\)"):
        predictor.recording(recording(dataset, 0), batch_size=0)
    with pytest.raises(ValueError, match=r"3 \* num_frames.* \(got \(1, 19, 61\)\)"):
        predictor(torch.zeros(1, 19, 61))
    fixed = Trials(frames(lengths=(50, 50)), pre_transform=KNNGraph(2))
    predictor, _ = predictor_of(fixed, GraspGCN("biotac", in_channels=50))
    assert predictor.recording(recording(fixed, 0)).shape == (1, 2)
    with pytest.raises(ValueError, match=r"must have 50 frames, like the trials .* \(got 64\)"):
        predictor.recording(recording(dataset, 1))
    single = Predictor(GraspGCN("biotac"), biotac(), adjacency=torch.tensor([[0, 1], [1, 0]]))
    with pytest.raises(ValueError, match="this predictor reads single frames, not windows"):
        single.windows(recording(dataset, 0))


@pytest.mark.parametrize("number", [1, 2])
def test_older_formats_have_neither_window_nor_threshold(number):
    predictor = Predictor(GraspGCN("biotac"), biotac(), transform=KNNGraph(2), threshold=0.4)
    header, tensors = _content.describe_predictor(predictor.preparation, predictor.network)
    assert (header["format"], header["threshold"]) == (3, 0.4)
    for key in ("threshold", "window", "frame_transform"):
        del header[key]
    header["format"] = number
    preparation, network = _content.build_predictor(header, tensors, predictor.model.state_dict())
    assert (network.threshold, preparation.window) == (None, None)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"length": 0}, r"'length' must be a number of frames of at least 1 \(got 0\)"),
        ({"length": 10**7 + 1}, r"'length' must be a number .* \(got 10000001\)"),
        ({"length": True}, r"'length' must be a number of frames of at least 1 \(got True\)"),
        ({"length": 5, "hop": -1}, r"'hop' must be a number of frames of at least 0 \(got -1\)"),
        ({"length": 5, "ragged": "cut"}, r"'ragged' must be one of .* \(got 'cut'\)"),
    ],
)
def test_bad_windows(arguments, match):
    with pytest.raises(ValueError, match=match):
        WindowCut(**arguments)
    with pytest.raises(ValueError, match=r"a window must have 'length', 'hop' and 'ragged'"):
        WindowCut.from_dict({"length": 5})
    assert WindowCut(10**7).to_dict() == {"length": 10**7, "hop": 1, "ragged": "error"}


@pytest.mark.parametrize("on_windows", [(), (SessionZScore("trial"),)])
def test_rest_that_is_measured_on_frames(on_windows):
    source = frames()
    transform = Compose([Tare("trial", first=10)])
    fit_transform(transform, source.batch(torch.arange(len(source))))
    model = TemporalTaxelNet(biotac(), 2, in_channels=3, widths=(4,), filter_size=2, num_blocks=1)
    data = Windows(frames(transform), 20, 3, label="trial")
    predictor, _ = predictor_of(data, model, *on_windows)
    assert predictor.preparation.measures_frames
    one = recording(data, 1)
    for call in (predictor.windows, predictor.recording):
        with pytest.raises(ValueError, match=r"'session' must be given, since Tare\('trial'"):
            call(one)
    assert predictor.adapt_recording(one) == 4
    found = predictor.recording(one)
    expected = said_of(predictor, data)[data.column("trial") == 1]
    assert torch.allclose(found, expected, atol=1e-6)
    joined = join_frames(torch.from_numpy(one.tactile[:20]).permute(1, 0, 2))
    assert torch.allclose(predictor(joined[None])[0], expected[0], atol=1e-6)
    with pytest.raises(ValueError, match=r"on frames, before windows are cut.*adapt_recording"):
        predictor.adapt_windows(predictor.windows(one)[0])
