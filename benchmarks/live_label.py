r"""From the first byte on the wire to the label, and a replay beside `tactile predict`."""

import copy
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from live_wire import Sender, sender

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.data import LiveFrame, Recording
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.live import (
    Judge,
    Judgement,
    OnnxModel,
    Stream,
    StreamEnded,
    Subscription,
    open_source,
)

_WRAP = 2**32 / 1e6  # seconds after which the clock of the board starts over
_TURN = 200  # frames that one judges before the other does
_WARM = 20  # of these that do not count
_RATE = 100.0
_STILL = 50  # frames of the rest


def measure_label(predictor: Predictor, onnx: Path, seconds: float) -> dict[str, Any]:
    r"""Returns milliseconds by part, as ONNX and eager in one run."""
    rest = np.zeros((384, 3))
    judges = {"onnx": Judge(onnx, rest), "eager": Judge(predictor, rest)}
    options = ("--rate", _RATE, "--seconds", seconds, "--taxels", 384, "--joints", 16)
    found: dict[str, list[tuple[float, Judgement]]] = {name: [] for name in judges}
    with sender("board", *options) as other:
        stream = Stream(open_source(f"serial:{other.name}?protocol=cobs"))
        subscription = stream.subscribe("newest")
        with stream:
            other.say()
            for number, frame in enumerate(_frames(subscription, other)):
                # In turns, such that whatever else the machine does meets both; not frame by frame,
                # since each would push the weights of the other out of the cache.
                name = ("onnx", "eager")[number // _TURN % 2]
                judgement = judges[name](frame)
                assert judgement is not None
                assert frame.device_time is not None
                sent = frame.device_time % _WRAP
                if number % _TURN >= _WARM:
                    found[name].append(((judgement.finished / 1e9 - sent) % _WRAP, judgement))
    return {name: _parts(parts) for name, parts in found.items()}


def measure_frame(onnx: Path, count: int = 300, repeats: int = 15) -> dict[str, Any]:
    r"""Returns what a judge does beside its model for a live frame: compare, thin and note gaps."""
    rest = np.zeros((384, 3))
    judge, alone = Judge(onnx, rest), OnnxModel(onnx)
    alone.set_rest(rest)
    draw = np.random.default_rng(0)
    frames = [
        LiveFrame(
            i, i / _RATE, 0, None, draw.normal(size=(384, 3)).astype("f4"), np.zeros(16, "f4")
        )
        for i in range(count)
    ]
    taken: dict[str, list[float]] = {"judge": [], "model alone": []}
    for _ in range(repeats):  # in turns, such that whatever else the machine does meets both
        judge.reset()
        start = perf_counter()
        for frame in frames:
            judge(frame)
        taken["judge"].append(perf_counter() - start)
        start = perf_counter()
        for frame in frames:
            alone.add(frame.tactile, frame.joint)
        taken["model alone"].append(perf_counter() - start)
    best = {name: 1000 * min(times) / count for name, times in taken.items()}
    out: dict[str, Any] = {f"{name} (ms)": value for name, value in best.items()}
    return {**out, "judge / model alone": best["judge"] / best["model alone"]}


def _frames(subscription: Subscription, other: Sender) -> Any:
    while True:
        try:
            yield subscription.get(timeout=1.0)
        except TimeoutError:
            if other.log.exists() or other.ended:
                return


def _parts(found: list[tuple[float, Judgement]]) -> dict[str, Any]:
    def percentiles(values: list[float]) -> dict[str, float]:
        p50, p99 = np.percentile(1000 * np.array(values), [50, 99])
        return {"p50 (ms)": float(p50), "p99 (ms)": float(p99)}

    judgements = [judgement for _, judgement in found]
    parts: dict[str, Any] = {"judgements": len(found)}
    parts["first byte to label"] = percentiles([whole for whole, _ in found])
    parts["decoded frame to label"] = percentiles(
        [j.latency["prepare"] + j.latency["model"] for j in judgements]
    )
    parts["wire and decoder"] = percentiles([w - j.latency["total"] for w, j in found])
    for name in ("wait", "prepare", "model"):
        parts[name] = percentiles([j.latency[name] for j in judgements])
    return parts


def measure_replay(predictor: Predictor, onnx: Path, seconds: float) -> dict[str, Any]:
    r"""Returns how a replayed recording is judged, beside the predictor on the same recording."""
    count = int(seconds * _RATE)
    draw = np.random.default_rng(0)
    recording = Recording(
        time=np.arange(count) / _RATE,
        tactile=draw.normal(size=(count, 384, 3)).astype(np.float32),
        joint=draw.uniform(0, 1, size=(count, 16)).astype(np.float32),
        meta={"sensor": "allegro_uskin", "unit": "count", "rate": _RATE},
    )
    still = recording.tactile[:_STILL]
    measured = copy.deepcopy(predictor)
    measured.adapt(still, recording.joint[:_STILL])
    wanted = measured.recording(recording).numpy()
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.h5"
        write_recording(recording, path)
        for name, model in (("onnx", onnx), ("eager", predictor)):
            judge = Judge(model, still.astype(np.float64).mean(0))
            got, times, received = _replayed(path, judge)
            drift = (received[-1] - received[0]) - (recording.time[-1] - recording.time[0])
            found[name] = {
                "frames": len(got),
                "same classes": bool((got.argmax(1) == wanted.argmax(1)).all()),
                "largest difference": float(np.abs(got - wanted).max()),
                "drift (ms a minute)": 1000 * abs(drift) / seconds * 60,
                "times increase": bool((np.diff(times) > 0).all()),
            }
    return found


def _replayed(path: Path, judge: Judge) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    stream = Stream(open_source(str(path)))
    subscription = stream.subscribe("all")
    probability, times, received = [], [], []
    with stream:
        while True:
            try:
                frame: LiveFrame = subscription.get(timeout=10)
            except StreamEnded:
                break
            judgement = judge(frame)
            assert judgement is not None
            probability.append(judgement.probability)
            times.append(frame.time)
            received.append(frame.received / 1e9)
    return np.array(probability), np.array(times), np.array(received)
