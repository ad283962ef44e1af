r"""Products with a constant sparse matrix in an ONNX graph, computed in blocks of rows."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

# Products of smaller matrices take less time than the operations that blocks add.
_MIN_ENTRIES = 256 * 256
_BLOCK_HEIGHTS = (16, 32, 64, 128)
# Number of multiplications that take as long as copying one feature of a neighbour (measured with
# onnxruntime).
_COPY_COST = 32


class _Blocks(NamedTuple):
    r"""Blocks of :math:`n` rows of a sparse matrix :math:`(N, N)`. Each block has only the columns
    that contain non-zero entries.

    Shapes:
        - **columns:** indices of columns :math:`(B, C)`
        - **values:** entries :math:`(B, n, C)`, where :math:`B \cdot n \geq N`
    """

    columns: np.ndarray
    values: np.ndarray

    @property
    def cost(self) -> int:
        r"""The number of multiplications per feature of a product, including the cost of copies."""
        return int(self.values.size + _COPY_COST * self.columns.size)


def compute_in_blocks(model: Any) -> int:
    r"""Replaces products of a constant sparse matrix, such as an adjacency, and features by a
    gather and a product of small dense blocks. Returns the number of replaced products.

    onnxruntime has no sparse product. On 384 taxels and 1,401 edges, blocks take a third of the
    time of the dense product. Padded neighbour lists (a gather, a product, a sum) take as long as
    the dense product.

    Args:
        model (onnx.ModelProto): The model, which is changed in place.
    """
    onnx = import_module("onnx")
    graph = model.graph
    ranks = {
        info.name: len(info.type.tensor_type.shape.dim)
        for info in (*graph.value_info, *graph.input)
    }
    constants = _constant_names(graph)
    products = [
        node
        for node in graph.node
        if node.op_type == "MatMul"
        and node.input[0] in constants
        and node.input[1] not in constants
        and ranks.get(node.input[1], 0) >= 2
    ]
    matrices = _constant_values(model, {node.input[0] for node in products}, constants)
    blocks_by_matrix: dict[bytes, tuple[_Blocks, str]] = {}
    num_replaced = 0
    for node in products:
        matrix = matrices[node.input[0]]
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.size < _MIN_ENTRIES:
            continue
        key = matrix.tobytes()
        if key not in blocks_by_matrix:
            blocks = _cheapest_blocks(matrix)
            if 2 * blocks.cost > matrix.size:
                continue
            name = f"blocks_{len(blocks_by_matrix)}"
            blocks_by_matrix[key] = blocks, name
            arrays = {f"{name}_columns": blocks.columns, f"{name}_values": blocks.values}
            graph.initializer.extend(
                onnx.numpy_helper.from_array(array, key) for key, array in arrays.items()
            )
        _replace_product(graph, node, *blocks_by_matrix[key], len(matrix), ranks[node.input[1]] - 2)
        num_replaced += 1
    if num_replaced:
        _remove_unused(graph)
    return num_replaced


def _constant_names(graph: Any) -> set[str]:
    r"""Returns the names of all values of a graph that do not depend on an input."""
    constants = {tensor.name for tensor in graph.initializer} | {""}
    constants -= {info.name for info in graph.input}
    for node in graph.node:
        has_subgraph = any(attribute.HasField("g") for attribute in node.attribute)
        is_random = node.op_type.startswith(("Random", "Bernoulli", "Multinomial"))
        if not has_subgraph and not is_random and constants.issuperset(node.input):
            constants.update(node.output)
    return constants


def _constant_values(model: Any, names: set[str], constants: set[str]) -> Mapping[str, np.ndarray]:
    r"""Returns the values of constants by name, computed by running a part of the graph."""
    if not names:
        return {}
    onnx, runtime = import_module("onnx"), import_module("onnxruntime")
    graph = model.graph
    subgraph = onnx.ModelProto()
    subgraph.CopyFrom(model)
    for field in ("node", "input", "output", "value_info"):
        subgraph.graph.ClearField(field)
    subgraph.graph.node.extend(node for node in graph.node if constants.issuperset(node.output))
    ordered = sorted(names)
    subgraph.graph.output.extend(onnx.ValueInfoProto(name=name) for name in ordered)
    options = runtime.SessionOptions()
    options.log_severity_level = 3
    session = runtime.InferenceSession(
        subgraph.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    return dict(zip(ordered, session.run(ordered, {}), strict=True))


def _cheapest_blocks(matrix: np.ndarray) -> _Blocks:
    return min((_blocks(matrix, num_rows) for num_rows in _BLOCK_HEIGHTS), key=lambda b: b.cost)


def _blocks(matrix: np.ndarray, num_rows: int) -> _Blocks:
    starts = range(0, len(matrix), num_rows)
    used_columns = [
        np.flatnonzero(matrix[start : start + num_rows].any(axis=0)) for start in starts
    ]
    width = max(1, *map(len, used_columns))
    columns = np.zeros((len(starts), width), np.int64)
    values = np.zeros((len(starts), num_rows, width), matrix.dtype)
    for i, (start, index) in enumerate(zip(starts, used_columns, strict=True)):
        rows = matrix[start : start + num_rows, index]
        columns[i] = start  # padding; its entries are zero
        columns[i, : len(index)] = index
        values[i, : len(rows), : len(index)] = rows
    return _Blocks(columns, values)


def _replace_product(
    graph: Any, node: Any, blocks: _Blocks, name: str, num_rows: int, lead: int
) -> None:
    onnx = import_module("onnx")
    helper, (output,), features = onnx.helper, node.output, node.input[1]
    num_blocks, rows_of_block, _ = blocks.values.shape
    num_padded_rows = num_blocks * rows_of_block
    gathered_name, product_name, joined_name = (
        f"{output}_{part}" for part in ("gathered", "product", "joined")
    )
    shape = np.array([0] * lead + [num_padded_rows, -1], np.int64)
    arrays = {f"{output}_shape": shape}
    nodes = [
        helper.make_node("Gather", [features, f"{name}_columns"], [gathered_name], axis=lead),
        helper.make_node("MatMul", [f"{name}_values", gathered_name], [product_name]),
    ]
    if num_padded_rows == num_rows:
        nodes.append(helper.make_node("Reshape", [product_name, f"{output}_shape"], [output]))
    else:
        nodes.append(helper.make_node("Reshape", [product_name, f"{output}_shape"], [joined_name]))
        bounds = {"starts": 0, "ends": num_rows, "axes": lead}
        names = {key: f"{output}_{key}" for key in bounds}
        arrays |= {names[key]: np.array([value], np.int64) for key, value in bounds.items()}
        nodes.append(helper.make_node("Slice", [joined_name, *names.values()], [output]))
    for i, new_node in enumerate(nodes):
        new_node.name = f"{node.name}_block_{i}"
    graph.initializer.extend(
        onnx.numpy_helper.from_array(array, key) for key, array in arrays.items()
    )
    position = list(graph.node).index(node)
    before, after = list(graph.node)[:position], list(graph.node)[position + 1 :]
    graph.ClearField("node")
    graph.node.extend([*before, *nodes, *after])


def _remove_unused(graph: Any) -> None:
    r"""Removes nodes, constants and shapes of values on which no output depends."""
    used_names = {info.name for info in graph.output}
    nodes = []
    for node in reversed(graph.node):
        if used_names.isdisjoint(node.output):
            continue
        nodes.append(node)
        used_names.update(node.input)
        for attribute in node.attribute:
            if attribute.HasField("g"):  # a subgraph may use any value in the graph
                used_names.update(name for inner in attribute.g.node for name in inner.input)
    _set_entries(graph, "node", nodes[::-1])
    for field in ("initializer", "value_info"):
        _set_entries(
            graph, field, [entry for entry in getattr(graph, field) if entry.name in used_names]
        )


def _set_entries(graph: Any, field: str, entries: list[Any]) -> None:
    copies = [type(entry).FromString(entry.SerializeToString()) for entry in entries]
    graph.ClearField(field)
    getattr(graph, field).extend(copies)
