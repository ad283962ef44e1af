r"""``tactile test``, whose arguments Lightning reads."""

from torch_geometric_tactile.commands.lightning import lightning_verb

HELP = "measure a checkpoint on the test part, also by recording session"
run_raw = lightning_verb("test")
