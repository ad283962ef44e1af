r"""The verbs of the command line, one file each.

A verb is a module with :obj:`HELP`, :obj:`DESCRIPTION`, :obj:`EXAMPLES`, :obj:`add_arguments` and
:obj:`run`. A verb with a parser of its own has :obj:`HELP` and :obj:`run_raw` instead.
The type of each argument says whether it names what is read or written (:mod:`._paths`), and
:obj:`list_outputs` returns further files that are written, such as those within a folder.
:obj:`EXTRAS` names the extras that a verb needs, and :obj:`KINDS` maps a first argument to another
module with its own arguments. All modules are imported to print the help, so they import heavy
packages in functions only.
"""

from importlib.util import find_spec

_VERBS: tuple[str, ...] = (
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
_LIVE = ("convert", "ports", "live", "record", "replay", "view")  # what `tactile-live` has

VERBS = _VERBS if find_spec("torch_geometric_tactile.nn") else _LIVE

__all__ = ["VERBS"]
