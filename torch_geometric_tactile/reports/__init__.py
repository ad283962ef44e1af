r"""Reports of results as HTML pages. Needs the extras ``train`` and ``viz``."""

from torch_geometric_tactile.reports.html import ReportPicture, ReportTable, write_report

__all__ = ["ReportPicture", "ReportTable", "write_report"]
