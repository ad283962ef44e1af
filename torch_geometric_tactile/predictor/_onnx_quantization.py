r"""Large linear maps of an ONNX graph with eight-bit weights."""

import tempfile
from importlib import import_module
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from torch_geometric_tactile.predictor._network import Network

# 2 MB. Smaller maps fit into the cache of a core, where integers save no time but cost accuracy.
MIN_QUANTIZED_WEIGHTS = 2**19


class Agreement(NamedTuple):
    r"""Differences between the predictions of a graph with eight-bit weights and the same graph in
    single precision.

    Args:
        equal_labels (float, optional): Share of predictions with the same labels; :obj:`None` for a
            regression.
        largest_change (float): Largest change of a probability or, in a regression, of a number in
            its unit.
        num_answers (int): Number of predictions that were compared.
        frames (str): Source of the readings: :obj:`"recordings"` or :obj:`"random"`.
    """

    equal_labels: float | None
    largest_change: float
    num_answers: int
    frames: str

    def __str__(self) -> str:
        kind = "frames or windows of recordings" if self.frames == "recordings" else "random frames"
        labels = (
            "" if self.equal_labels is None else f"{100 * self.equal_labels:.2f} % same labels, "
        )
        return f"{labels}largest change {self.largest_change:.2g} on {self.num_answers:,} {kind}"


def quantize_weights(model: Any) -> tuple[Any, int]:
    r"""Returns a model whose large linear maps have eight-bit weights, and the number of these
    weights. Each output has a separate scale. Inputs are quantized at each call.

    Weights are unsigned, because the file may run on any machine, and processors without VNNI
    saturate sums of signed weights.

    Args:
        model (onnx.ModelProto): The model, which is not changed.

    Raises:
        ValueError: If the model has no large linear map.
    """
    onnx = import_module("onnx")
    quantization = import_module("onnxruntime.quantization")
    sizes = {
        tensor.name: prod(tensor.dims)
        for tensor in model.graph.initializer
        if len(tensor.dims) == 2 and tensor.data_type == onnx.TensorProto.FLOAT
    }
    linear_nodes = [
        node
        for node in model.graph.node
        if node.op_type in ("MatMul", "Gemm")
        and sizes.get(node.input[1], 0) >= MIN_QUANTIZED_WEIGHTS
    ]
    if not linear_nodes:
        raise ValueError(
            f"the model must have a linear map of at least {MIN_QUANTIZED_WEIGHTS:,} weights to be "
            f"quantized (got {max(sizes.values(), default=0):,} in its largest): leave out "
            "'quantize'"
        )
    source = onnx.ModelProto()
    source.CopyFrom(model)
    # Shapes written by PyTorch prevent onnxruntime from inferring the shapes that the quantizer
    # needs.
    source.graph.ClearField("value_info")
    entry = source.metadata_props.add()  # avoids a warning of the quantizer
    entry.key, entry.value = "onnx.quant.pre_process", "onnxruntime.quant"
    names = [
        name for node in linear_nodes for name in (node.name, f"{node.name}_MatMul")
    ]  # the node of a Gemm
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
        quantized = onnx.load(path)
    quantized.ClearField("metadata_props")
    return quantized, sum(sizes[name] for name in {node.input[1] for node in linear_nodes})


def compare_predictions(
    single: np.ndarray, quantized: np.ndarray, network: Network, frames: str
) -> Agreement:
    r"""Returns the differences between the predictions of two graphs. Predictions that are missing
    (NaN) in both graphs are skipped.

    Args:
        single (numpy.ndarray): Predictions in single precision :math:`(M, K)`.
        quantized (numpy.ndarray): Predictions with eight-bit weights :math:`(M, K)`.
        network (Network): The network, which converts probabilities to labels.
        frames (str): As in :class:`Agreement`.

    Raises:
        ValueError: If a prediction is missing in only one graph, or all predictions are missing.
    """
    is_missing = np.isnan(single).any(axis=1)
    if not np.array_equal(np.isnan(single), np.isnan(quantized)):
        raise ValueError(
            "the graph with eight-bit weights must be NaN for the same readings as the graph in "
            "single precision (got other readings): nothing was written"
        )
    single, quantized = single[~is_missing], quantized[~is_missing]
    if not len(single):
        raise ValueError(
            "'check' must have frames without missing readings to compare predictions (got none)"
        )
    equal_labels = None
    if network.task != "regression":
        labels = [network.labels(torch.from_numpy(rows)) for rows in (single, quantized)]
        equal_labels = float(np.mean([a == b for a, b in zip(*labels, strict=True)]))
    change = float(np.abs(single - quantized).max())
    return Agreement(equal_labels, change, len(single), frames)
