r"""``tactile validate``, whose arguments Lightning reads."""

from torch_geometric_tactile.commands.lightning import lightning_verb

HELP = "measure a checkpoint on the validation part"
run_raw = lightning_verb("validate")
