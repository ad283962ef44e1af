r"""The verbs of the command line, one file each.

A verb is a module with :obj:`HELP`, :obj:`DESCRIPTION`, :obj:`EXAMPLES`, :obj:`add_arguments` and
:obj:`run`; one whose arguments another parser reads has :obj:`HELP` and :obj:`run_raw`. One with
other arguments after a certain first word names the module of them in :obj:`KINDS`. Modules are
imported to print the help of all verbs, so that heavy packages are imported in functions only.
"""

VERBS = (
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
    "fit",
    "validate",
    "test",
    "predict",
    "export",
)

__all__ = ["VERBS"]
