r"""Large linear maps of an ONNX graph with weights of eight bits."""

import tempfile
from importlib import import_module
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from torch_geometric_tactile.predictor._network import Network

# 2 MB. Smaller maps stay in the cache of a core: integers gain no time, and cost accuracy.
MIN_WEIGHTS = 2**19


class Agreement(NamedTuple):
    r"""How the answers of a graph with weights of eight bits differ from those of its graph in
    single precision.

    Args:
        equal_labels (float, optional): Share of the answers with the same labels; :obj:`None` for
            a regression.
        largest_change (float): Largest change of a probability, or of a number of a regression in
            its unit.
        num_answers (int): Number of answers that were compared.
        frames (str): What they were answers to: :obj:`"recordings"` or :obj:`"random"` readings.
    """

    equal_labels: float | None
    largest_change: float
    num_answers: int
    frames: str

    def __str__(self) -> str:
        kind = "frames or windows of recordings" if self.frames == "recordings" else "random ones"
        labels = (
            "" if self.equal_labels is None else f"{100 * self.equal_labels:.2f} % same labels, "
        )
        return f"{labels}largest change {self.largest_change:.2g}, on {self.num_answers:,} {kind}"


def quantize_weights(model: Any) -> tuple[Any, int]:
    r"""Returns a model whose large linear maps multiply integers of eight bits, and how many
    weights these are. Each output has a scale of its own, and inputs are quantized at each call.

    Weights are unsigned: processors without VNNI saturate sums of signed ones, and the file may run
    on another machine than this one.

    Args:
        model (onnx.ModelProto): The model, which stays as it is.

    Raises:
        ValueError: If it has no large linear map.
    """
    onnx = import_module("onnx")
    quantization = import_module("onnxruntime.quantization")
    weights = {
        tensor.name: prod(tensor.dims)
        for tensor in model.graph.initializer
        if len(tensor.dims) == 2 and tensor.data_type == onnx.TensorProto.FLOAT
    }
    maps = [
        node
        for node in model.graph.node
        if node.op_type in ("MatMul", "Gemm") and weights.get(node.input[1], 0) >= MIN_WEIGHTS
    ]
    if not maps:
        raise ValueError(
            f"the model must have a linear map of at least {MIN_WEIGHTS:,} weights to gain by "
            f"integers (got {max(weights.values(), default=0):,} in its largest): leave out "
            "'quantize'"
        )
    source = onnx.ModelProto()
    source.CopyFrom(model)
    # Shapes that PyTorch wrote stop onnxruntime's own, which the quantizer needs.
    source.graph.ClearField("value_info")
    mark = source.metadata_props.add()  # without which it logs a warning
    mark.key, mark.value = "onnx.quant.pre_process", "onnxruntime.quant"
    names = [name for node in maps for name in (node.name, f"{node.name}_MatMul")]  # of a Gemm
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        quantization.quantize_dynamic(
            source,
            path,
            op_types_to_quantize=["MatMul"],
            per_channel=True,
            weight_type=quantization.QuantType.QUInt8,
            nodes_to_quantize=names,
        )
        result = onnx.load(path)
    result.ClearField("metadata_props")
    return result, sum(weights[name] for name in {node.input[1] for node in maps})


def compare_answers(
    single: np.ndarray, quantized: np.ndarray, network: Network, frames: str
) -> Agreement:
    r"""Compares the answers of two graphs. Those that are missing in both are not counted.

    Args:
        single (numpy.ndarray): Answers in single precision :math:`(M, K)`.
        quantized (numpy.ndarray): Answers with weights of eight bits :math:`(M, K)`.
        network (Network): What turns them into labels.
        frames (str): As of :class:`Agreement`.

    Raises:
        ValueError: If one of them alone has no answer, or there is none at all.
    """
    missing = np.isnan(single).any(axis=1)
    if not np.array_equal(np.isnan(single), np.isnan(quantized)):
        raise ValueError(
            "the graph with weights of eight bits must have an answer where the other has one: "
            "nothing was written"
        )
    single, quantized = single[~missing], quantized[~missing]
    if not len(single):
        raise ValueError(
            "'check' must have frames without missing readings to compare answers (got none)"
        )
    equal = None
    if network.task != "regression":
        labels = [network.labels(torch.from_numpy(rows)) for rows in (single, quantized)]
        equal = float(np.mean([a == b for a, b in zip(*labels, strict=True)]))
    change = float(np.abs(single - quantized).max())
    return Agreement(equal, change, len(single), frames)
