r"""``tactile export``: writes a predictor as one ONNX graph."""

import argparse
import sys

from torch_geometric_tactile.commands._arguments import seconds, small_count
from torch_geometric_tactile.commands._file_kinds import ONNX_MODEL
from torch_geometric_tactile.commands._paths import OutputFile, input_path

HELP = "Export a model with its preprocessing to one ONNX file"
DESCRIPTION = """\
Writes a model as one ONNX graph that includes scaling, kinematics, edge features and the
network, and runs without PyTorch. Its inputs are raw readings and, where needed, the
reading at rest and joint angles; its outputs are probabilities. The graph is first compared
with PyTorch: nothing is written if the outputs differ by more than 1e-5. Needs the extra 'export'.

--quantize stores the weights of large linear maps in eight bits: the file is smaller and faster,
and its outputs differ slightly. The command compares the labels before and after, on the
recordings of --check (such as validation recordings) or on random readings. The file is
written in any case; the exit status is 1 if fewer than 99.9 % of the labels on the recordings
agree.
"""
EXAMPLES = """\
examples:
  tactile export grasp.predictor grasp.onnx
  tactile export biotac_sp_slip slip.onnx        a trained model of the package
  tactile export last.ckpt grasp.onnx --unit count
                                                 with the unit of the readings in its metadata
  tactile export last.ckpt grasp.onnx --tare     subtracts the reading at rest in the graph
  tactile export grasp.predictor grasp8.onnx --quantize --check validation/*.h5 --rest 0.5
                                                 eight-bit weights, compared on recordings that
                                                 begin with half a second at rest
"""
_MIN_EQUAL_LABELS = 0.999


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "predictor",
        metavar="MODEL",
        type=input_path,
        help="a checkpoint, a predictor from 'tactile predict --save', or the name of a predictor "
        "in docs/pretrained.md, such as biotac_sp_slip",
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
        help="unit of the readings, stored in the metadata of the file",
    )
    parser.add_argument(
        "--tare",
        action="store_true",
        help="for a model trained on tared readings: the exported graph takes raw readings and "
        "the reading at rest, and subtracts it",
    )
    parser.add_argument(
        "--quantize",
        action="store_true",
        help="eight-bit weights for linear maps with 524,288 weights (2 MB) or more",
    )
    parser.add_argument(
        "--check",
        metavar="RECORDING",
        type=input_path,
        nargs="+",
        default=[],
        help="recordings on which --quantize compares labels (default: random readings)",
    )
    parser.add_argument(
        "--rest",
        metavar="SECONDS",
        type=seconds,
        help="for models with a tare: time at the start of each recording of --check in which "
        "nothing touches the sensor (default: as in training)",
    )
    parser.add_argument(
        "--channels",
        metavar="N",
        type=small_count,
        help="channels per taxel, if the predictor does not contain their number",
    )
    parser.add_argument(
        "--config",
        metavar="CONFIG",
        type=input_path,
        help="configuration with your own model or transforms",
    )


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    if not arguments.model.endswith(".onnx"):
        raise ValueError(f"'FILE.onnx' must end in .onnx (got '{arguments.model}')")
    if arguments.check and not arguments.quantize:
        raise ValueError("'--check' must be left out without '--quantize'")
    if arguments.rest is not None and not arguments.check:
        raise ValueError(
            "'--rest' must be left out without '--check': it is the time at rest of its recordings"
        )
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.live.onnx_judge import OnnxModel
    from torch_geometric_tactile.predictor.export_onnx import export_onnx
    from torch_geometric_tactile.reports import _run_data as run_data
    from torch_geometric_tactile.reports._predictions import open_recording

    predictor = run_data.open_predictor(arguments.predictor, arguments.config)
    if arguments.tare:
        predictor = predictor.with_tare()
    exported = export_onnx(
        predictor,
        arguments.model,
        unit=arguments.unit,
        num_channels=arguments.channels,
        quantize=arguments.quantize,
        check=[open_recording(predictor, path) for path in arguments.check],
        rest=arguments.rest,
    )
    model = OnnxModel(arguments.model)
    milliseconds = 1e3 * model.typical_seconds()
    lines = [
        f"wrote {arguments.model}: {predictor}, {exported.num_bytes / 1e6:.1f} MB",
        f"  inputs:  {_format_shapes(model.inputs)}",
        f"  outputs: {_format_shapes(model.outputs)}",
        f"  largest difference from PyTorch: {exported.difference:.1e}",
        f"  one prediction on this machine, one thread: {milliseconds:.2f} ms (median)",
    ]
    agreement = exported.agreement
    if agreement is not None:
        lines.insert(-1, f"  eight-bit weights: {agreement}")  # before the time
    for line in lines:
        print(printable(line))
    share = None if agreement is None or not arguments.check else agreement.equal_labels
    if share is None or share >= _MIN_EQUAL_LABELS:
        return 0
    print(
        f"fewer than {100 * _MIN_EQUAL_LABELS:.1f} % of the labels agree: export without "
        "--quantize, or test the file before you use it",
        file=sys.stderr,
    )
    return 1


def _format_shapes(shapes: dict[str, list[int]]) -> str:
    return ", ".join(f"{name} ({', '.join(map(str, shape))})" for name, shape in shapes.items())
