# ruff: noqa: E402
"""Sparse products of a graph in blocks of rows give the numbers of the dense product."""

import numpy as np
import pytest

for extra in ("onnx", "onnxruntime"):
    pytest.importorskip(extra, reason="needs the extra 'export'")

import onnx
import onnxruntime
from onnx import helper, numpy_helper

from torch_geometric_tactile.predictor._onnx_products import compute_in_blocks

NUM_FEATURES = 5


def banded(num_nodes, dtype=np.float32):
    """Each node has its neighbours and a far one."""
    matrix = np.zeros((num_nodes, num_nodes), dtype)
    for i in range(num_nodes):
        for j in (i - 1, i, i + 1, i + num_nodes // 2):
            matrix[i, j % num_nodes] = 1 + i + 0.5 * j
    return matrix / num_nodes


def model(matrix, lead=(1,), num_products=2):
    """Products with a matrix that the graph computes from constants, one after the other."""
    size = [*lead, len(matrix), NUM_FEATURES]
    nodes, inputs = [], "x"
    for i in range(num_products):
        nodes.append(helper.make_node("Mul", ["half", "two"], [f"a{i}"], name=f"mul{i}"))
        nodes.append(helper.make_node("MatMul", [f"a{i}", inputs], [f"y{i}"], name=f"product{i}"))
        inputs = f"y{i}"
    float32 = onnx.TensorProto.FLOAT
    infos = [helper.make_tensor_value_info(f"y{i}", float32, size) for i in range(num_products)]
    constants = {"half": matrix / 2, "two": np.array(2, np.float32)}
    graph = helper.make_graph(
        nodes,
        "products",
        [helper.make_tensor_value_info("x", float32, size)],
        infos[-1:],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
        value_info=infos[:-1],
    )
    out = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)])
    out.ir_version = 10
    return out


def answer(program, x):
    onnx.checker.check_model(program)
    session = onnxruntime.InferenceSession(program.SerializeToString())
    return session.run(None, {"x": x})[0]


@pytest.mark.parametrize("lead", [(), (1,), (2, 3)], ids=str)
@pytest.mark.parametrize("num_nodes", [256, 384, 391])  # the last no multiple of any block
def test_blocks_give_the_numbers_of_the_dense_product(num_nodes, lead):
    matrix = banded(num_nodes)
    dense, blocks = model(matrix, lead), model(matrix, lead)
    assert compute_in_blocks(blocks) == 2
    x = np.random.default_rng(0).standard_normal((*lead, num_nodes, NUM_FEATURES), np.float32)
    expected = answer(dense, x)
    np.testing.assert_allclose(answer(blocks, x), expected, rtol=1e-4, atol=1e-5)
    by_hand = matrix.astype(np.float64) @ (matrix.astype(np.float64) @ x)
    np.testing.assert_allclose(expected, by_hand, rtol=1e-4, atol=1e-4)


def test_equal_matrices_are_stored_once_and_dense_ones_removed():
    program = model(banded(384))
    compute_in_blocks(program)
    names = {tensor.name for tensor in program.graph.initializer}
    assert {"blocks_0_columns", "blocks_0_values"} < names
    assert names.isdisjoint({"half", "two", "blocks_1_values"})
    assert sum(tensor.ByteSize() for tensor in program.graph.initializer) < 384 * 384
    assert [node.op_type for node in program.graph.node] == ["Gather", "MatMul", "Reshape"] * 2


@pytest.mark.parametrize(
    "matrix",
    [banded(100), np.ones((384, 384), np.float32)],
    ids=["small", "dense"],
)
def test_small_and_dense_matrices_stay(matrix):
    program = model(matrix)
    before = program.SerializeToString()
    assert compute_in_blocks(program) == 0
    assert program.SerializeToString() == before


def test_a_matrix_that_depends_on_an_input_stays():
    program = model(banded(384), num_products=1)
    program.graph.input.append(helper.make_tensor_value_info("two", onnx.TensorProto.FLOAT, []))
    assert compute_in_blocks(program) == 0
