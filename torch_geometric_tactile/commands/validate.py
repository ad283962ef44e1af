r"""``tactile validate``: computes the metrics on the validation part; Lightning parses the
arguments.
"""

from torch_geometric_tactile.commands._lightning import lightning_command

HELP = "Compute the metrics of a checkpoint on the validation part"
DESCRIPTION = """\
Computes the metrics of a checkpoint on the validation part of the data. Give the
configuration of the run, which lies beside its checkpoints. Needs the extra 'train'.
"""
EXAMPLES = """\
examples:
  tactile validate --config grasp_gcn_df --ckpt_path runs/grasp_gcn_df/version_0/checkpoints/last.ckpt
  tactile validate --config runs/my/version_0/config.yaml --ckpt_path runs/my/version_0/checkpoints/last.ckpt
  tactile validate --config my.yaml --ckpt_path last.ckpt --trainer.accelerator cpu
"""  # noqa: E501
run_raw = lightning_command("validate", DESCRIPTION, "the checkpoint to validate", EXAMPLES)
