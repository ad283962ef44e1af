"""Small predictors of frames, windows and sessions, and a recording for them."""

import functools
import tempfile
from pathlib import Path

import numpy as np
import small_models
import torch
from sklearn.pipeline import Pipeline
from torch_geometric.transforms import Compose

from torch_geometric_tactile import Predictor
from torch_geometric_tactile import transforms as T
from torch_geometric_tactile.baselines import TemperatureScaling, descriptor_svm, signal_svm
from torch_geometric_tactile.data import LiveFrame, Recording, StaticData, StaticDataset, Windows
from torch_geometric_tactile.datasets import RecordingFrames
from torch_geometric_tactile.nn.models import GraspLSTM, TactileGCN, TemporalTaxelNet
from torch_geometric_tactile.predictor import estimator_predictor

LAYOUT = small_models.LAYOUT
LENGTH = 6  # of windows
NAMES = ["ball", "cube"]


def dataset(transform=None):
    draw = torch.Generator().manual_seed(0)
    touch = torch.arange(11).view(11, 1) * torch.rand(80, 1, 3, generator=draw)
    data = StaticData(
        x=30000 + 40 * torch.randn(80, 11, 3, generator=draw) + 30 * touch,
        joint=torch.rand(80, 2, generator=draw),
        session=torch.arange(80) // 20,
        trial=torch.arange(80) // 20,
        step=torch.arange(80) % 20,
        y=torch.arange(80) // 20 % 2,
        pos=LAYOUT.pos,
        edge_index=LAYOUT.edge_index("original"),
    )
    return StaticDataset._from_samples((data, {"class": NAMES}), LAYOUT, transform, None, None)


def _fitted(model, data, *parts):
    transform = Compose(parts)
    T.fit_parts(transform, data)
    return Predictor.from_dataset(model.eval(), data, transform)


def frame():
    model = TactileGCN(
        LAYOUT, 2, segments="patch", num_joints=2, **small_models.NARROW, **small_models.HEAD
    )
    scale = T.ZScore(per="channel"), T.ZScore(attr="joint"), T.FillMissing()
    return _fitted(model, dataset(), *scale)


def tare():
    model = TactileGCN(LAYOUT, 2, **small_models.NARROW, **small_models.HEAD)
    return _fitted(model, dataset(), T.Tare(first=30), T.ZScore(per="channel"))


def session():
    model = TactileGCN(LAYOUT, 2, **small_models.NARROW, **small_models.HEAD)
    return _fitted(model, dataset(), T.CommonMode(), T.SessionZScore())


def window():
    model = GraspLSTM(LAYOUT, 2, hidden_channels=4)
    return _fitted(model, Windows(dataset(), LENGTH), T.ZScore(per="signal"))


def window_tare():
    model = GraspLSTM(LAYOUT, 2, hidden_channels=4)
    data = Windows(dataset(), LENGTH)
    return _fitted(model, data, T.Tare(first=8), T.ZScore(per="signal"))


def frames_tare():
    made = [recording(seed=i, label=NAMES[i % 2]) for i in range(4)]
    frames = RecordingFrames(
        layout=LAYOUT, recordings=made, target="label", adjacency="original", tare=0.5
    )
    model = GraspLSTM(LAYOUT, 2, hidden_channels=4)
    return _fitted(model, Windows(frames, LENGTH), T.ZScore(per="signal"))


def stepped():
    model = TemporalTaxelNet(
        LAYOUT,
        2,
        in_channels=3,
        num_filters=2,
        filter_size=2,
        dilation=1,
        num_blocks=1,
        widths=(4,),
    )
    return _fitted(model, Windows(dataset(), LENGTH), T.ZScore(per="signal"))


def _of_estimator(pipeline, data, *parts):
    transform = Compose(parts)
    seen = T.fit_transform(transform, data.data)
    *first, (name, machine) = pipeline.steps
    machine = TemperatureScaling(machine).set_params(estimator__random_state=0)
    pipeline = Pipeline([*first, (name, machine)])
    return estimator_predictor(pipeline.fit(seen, seen.y.numpy()), data, transform)


def machine():
    scale = T.Tare("trial", first=8), T.ZScore(scale_per="channel"), T.FillMissing()
    return _of_estimator(descriptor_svm(LAYOUT), dataset(), *scale)


def window_machine():
    windows = Windows(dataset(), LENGTH)
    return _of_estimator(signal_svm(num_channels=3), windows, T.ZScore(per="signal"))


MAKES = {
    make.__name__: make
    for make in (
        *(frame, tare, session, window, window_tare, frames_tare, stepped),
        *(machine, window_machine),
    )
}


@functools.cache
def predictor(name):
    torch.manual_seed(0)
    return MAKES[name]()


@functools.cache
def onnx_file(name):
    """The file of a predictor in ONNX, made once."""
    from torch_geometric_tactile.predictor import export_onnx

    path = Path(tempfile.mkdtemp(prefix="onnx_")) / f"{name}.onnx"
    export_onnx(predictor(name), path)
    return path


def recording(num_frames=60, rest=30, seed=1, label=None):
    """At rest, then touched."""
    draw = np.random.default_rng(seed)
    tactile = 30100 + 5 * draw.standard_normal((num_frames, 11, 3))
    tactile[rest:] += 60 * draw.standard_normal((num_frames - rest, 11, 3))
    joint = draw.uniform(0, 1, (num_frames, 2))
    time = np.arange(num_frames) / 25
    return Recording(time=time, tactile=tactile.astype(np.float32), joint=joint, label=label)


def recording_at_rest():
    """The first half of :func:`recording`."""
    whole = recording()
    return Recording(time=whole.time[:30], tactile=whole.tactile[:30], joint=whole.joint[:30])


def live_frames(recording, first=0):
    for i in range(first, recording.num_frames):
        time = float(recording.time[i]) + 1000
        yield LiveFrame(i, time, int(time * 1e9), None, recording.tactile[i], recording.joint[i])
