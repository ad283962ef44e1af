r"""``tactile export``: a predictor as one ONNX graph."""

import argparse

HELP = "write a checkpoint or predictor as one ONNX graph, from raw readings to probabilities"
DESCRIPTION = """\
Writes a predictor as one file in ONNX: scaling, kinematics, edge features and network in one
graph, which runs without PyTorch. Raw readings go in, with the rest of the session and joint
angles where they are needed; probabilities come out. The graph is compared with PyTorch
first: if they differ by more than 1e-5, nothing is written. PREDICTOR is a checkpoint of
'tactile fit' or a file of 'tactile predict --save'.
"""
EXAMPLES = """\
examples:
  tactile export grasp.predictor grasp.onnx
  tactile export last.ckpt grasp.onnx --unit count
                                                 with the unit of the readings in its metadata
  tactile export own.predictor own.onnx --channels 3
                                                 for a predictor that does not say its channels
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    from torch_geometric_tactile.commands.arguments import add_allow, few

    parser.add_argument(
        "predictor", metavar="PREDICTOR", help="a checkpoint, or a file of 'tactile predict --save'"
    )
    parser.add_argument("model", metavar="MODEL.onnx", help="the file to write")
    parser.add_argument(
        "--unit",
        choices=("count", "newton"),
        help="the unit of the readings, for the metadata of the file",
    )
    parser.add_argument(
        "--tare",
        action="store_true",
        help="of a predictor that was trained on readings relative to rest: the file takes raw "
        "readings, and the rest beside them",
    )
    parser.add_argument(
        "--channels",
        metavar="N",
        type=few,
        help="channels of a taxel, for a predictor that does not say",
    )
    parser.add_argument(
        "--config",
        metavar="CONFIG",
        help="the configuration of models and transforms of your own; by default the config.yaml "
        "that the run has beside its checkpoints",
    )
    add_allow(parser)


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (argparse.Namespace): The arguments.
    """
    if not arguments.model.endswith(".onnx"):
        raise ValueError(f"'MODEL.onnx' must be a name that ends in .onnx (got {arguments.model})")
    from torch_geometric_tactile.live.onnx_judge import OnnxModel
    from torch_geometric_tactile.predictor.export_onnx import export_onnx, require_export
    from torch_geometric_tactile.reports import run_data
    from torch_geometric_tactile.texts import printable

    require_export()
    predictor = run_data.open_predictor(arguments.predictor, arguments.config, arguments.allow)
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
