r"""``tactile fit``, whose arguments Lightning reads."""

from torch_geometric_tactile.commands.lightning import lightning_verb

HELP = "train a model from a configuration"
run_raw = lightning_verb("fit")
