r"""``tactile export``: a predictor as one ONNX graph."""

import argparse

from torch_geometric_tactile.commands._arguments import small_count
from torch_geometric_tactile.commands._file_kinds import ONNX_MODEL
from torch_geometric_tactile.commands._paths import OutputFile, input_path

HELP = "Export a model with its preprocessing to one ONNX file"
DESCRIPTION = """\
Writes a model as one ONNX graph that includes scaling, kinematics, edge features and the
network, and runs without PyTorch. Its inputs are raw readings, and, where needed, the
reading at rest and joint angles; its outputs are probabilities. The graph is first compared
with PyTorch: nothing is written if they differ by more than 1e-5. Needs the extra 'export'.
"""
EXAMPLES = """\
examples:
  tactile export grasp.predictor grasp.onnx
  tactile export last.ckpt grasp.onnx --unit count
                                                 with the unit of the readings in its metadata
  tactile export last.ckpt grasp.onnx --tare     subtracts the reading at rest in the graph
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb."""
    parser.add_argument(
        "predictor",
        metavar="MODEL",
        type=input_path,
        help="a checkpoint, or a predictor of 'tactile predict --save'",
    )
    parser.add_argument(
        "model",
        metavar="FILE.onnx",
        type=OutputFile("FILE.onnx", ONNX_MODEL),
        help="the file to write",
    )
    parser.add_argument(
        "--unit",
        choices=("count", "newton", "microtesla"),
        help="unit of the readings, written to the metadata of the file",
    )
    parser.add_argument(
        "--tare",
        action="store_true",
        help="for a model trained on tared readings: the exported graph takes raw readings and "
        "the reading at rest, and subtracts it",
    )
    parser.add_argument(
        "--channels",
        metavar="N",
        type=small_count,
        help="channels per taxel, if the predictor does not contain them",
    )
    parser.add_argument(
        "--config",
        metavar="CONFIG",
        type=input_path,
        help="configuration with a model or transforms of your own",
    )


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status."""
    if not arguments.model.endswith(".onnx"):
        raise ValueError(f"'FILE.onnx' must end in .onnx (got '{arguments.model}')")
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.live.onnx_judge import OnnxModel
    from torch_geometric_tactile.predictor.export_onnx import export_onnx
    from torch_geometric_tactile.reports import _run_data as run_data

    predictor = run_data.open_predictor(arguments.predictor, arguments.config)
    if arguments.tare:
        predictor = predictor.with_tare()
    exported = export_onnx(
        predictor, arguments.model, unit=arguments.unit, num_channels=arguments.channels
    )
    model = OnnxModel(arguments.model)
    milliseconds = 1e3 * model.typical_seconds()
    lines = [
        f"wrote {arguments.model}: {predictor}, {exported.num_bytes / 1e6:.1f} MB",
        f"  inputs:  {_shapes(model.inputs)}",
        f"  outputs: {_shapes(model.outputs)}",
        f"  largest difference to PyTorch: {exported.difference:.1e}",
        f"  one judgement on this machine, one thread: {milliseconds:.2f} ms (p50)",
    ]
    for line in lines:
        print(printable(line))
    return 0


def _shapes(shapes: dict[str, list[int]]) -> str:
    return ", ".join(f"{name} ({', '.join(map(str, shape))})" for name, shape in shapes.items())
