r"""The commands of the command line, one module each.

A command is a module with :obj:`HELP`, :obj:`DESCRIPTION`, :obj:`EXAMPLES`, :obj:`add_arguments`
and :obj:`run`. A command whose arguments Lightning parses has :obj:`HELP` and :obj:`run_raw`
instead. The type of an argument declares whether it names an input or an output (:mod:`._paths`);
:obj:`list_outputs` returns further output files, such as files within a folder.
:obj:`EXTRAS` names the extras that a command needs, and :obj:`KINDS` maps a first argument to
another module with its own arguments. Printing the help imports all of these modules, so they
import large packages only inside functions.
"""

from importlib.util import find_spec

_ALL_COMMANDS: tuple[str, ...] = (
    "demo",
    "inspect",
    "convert",
    "simulate",
    "ports",
    "live",
    "record",
    "replay",
    "view",
    "analyze",
    "table",
    "compare",
    "board",
    "calibrate",
    "fit",
    "validate",
    "test",
    "predict",
    "export",
)
# The commands of the distribution `tactile-live`, which does not include PyTorch.
_LIVE_COMMANDS = ("convert", "ports", "live", "record", "replay", "view")

COMMANDS = _ALL_COMMANDS if find_spec("torch_geometric_tactile.nn") else _LIVE_COMMANDS

__all__ = ["COMMANDS"]
