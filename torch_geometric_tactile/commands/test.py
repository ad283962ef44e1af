r"""``tactile test``: computes the metrics on the test part; Lightning parses the arguments."""

from torch_geometric_tactile.commands._lightning import lightning_command

HELP = "Compute the metrics of a checkpoint on the test part"
DESCRIPTION = """\
Computes the metrics of a checkpoint on the test part of the data, overall and for each
recording session. Give the configuration of the run, which lies beside its checkpoints.
Needs the extra 'train'.
"""
EXAMPLES = """\
examples:
  tactile test --config grasp_gcn_df --ckpt_path runs/grasp_gcn_df/version_0/checkpoints/last.ckpt
  tactile test --config runs/my/version_0/config.yaml --ckpt_path runs/my/version_0/checkpoints/last.ckpt
  tactile test --config my.yaml --ckpt_path last.ckpt --data.batch_size 16
"""  # noqa: E501
run_raw = lightning_command("test", DESCRIPTION, "the checkpoint to test", EXAMPLES)
