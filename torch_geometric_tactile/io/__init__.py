r"""File formats: one per file, the only home of byte layouts."""

from torch_geometric_tactile.io.biotac_sp_csv import GraspTable, read_biotac_sp_csv

__all__ = ["GraspTable", "read_biotac_sp_csv"]
