r"""``tactile fit``: trains a model; Lightning parses the arguments."""

from torch_geometric_tactile.commands._lightning import lightning_command

HELP = "Train a model from a configuration"
DESCRIPTION = """\
Trains the model described by a configuration (YAML) and writes the run to runs/NAME/version_K:
config.yaml, metrics.csv and checkpoints/last.ckpt. Any entry of the configuration can also be
set on the command line, as in --trainer.max_epochs 20. Ctrl-C loses at most the current epoch;
--ckpt_path resumes the training. Needs the extra 'train'.
"""
EXAMPLES = """\
examples:
  tactile fit --config grasp_gcn_df
  tactile fit --config my.yaml --trainer.max_epochs 50 --seed_everything 1
  tactile fit --config grasp_gcn_df --ckpt_path runs/grasp_gcn_df/version_0/checkpoints/last.ckpt

The shipped configurations are listed in docs/command_line.md.
"""
run_raw = lightning_command("fit", DESCRIPTION, "resume the training of this checkpoint", EXAMPLES)
