r"""Experiments: data sources, plans, runs, comparisons and tables. Needs the extra ``train``."""

from typing import TYPE_CHECKING

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.experiments.advice import advice, recommended
from torch_geometric_tactile.experiments.compared_windows import FrameCut, data_source
from torch_geometric_tactile.experiments.comparison import (
    Comparison,
    ComparisonSettings,
    ModelResult,
    Summary,
    compare,
    comparison_plan,
    summarize,
)
from torch_geometric_tactile.experiments.deploy import deploy
from torch_geometric_tactile.experiments.differences import Difference, Signs, paired_difference
from torch_geometric_tactile.experiments.plan import Plan, PlanRun, Settings, make_plan
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.run_plan import run_plan
from torch_geometric_tactile.experiments.source import DataFacts, DataSource
from torch_geometric_tactile.experiments.studies import Confusion, Study, Trained
from torch_geometric_tactile.experiments.tables import (
    Cell,
    Ordering,
    Table,
    TableProtocol,
    read_table,
)

__all__ = [
    "Cell",
    "Comparison",
    "ComparisonSettings",
    "Confusion",
    "DataFacts",
    "DataSource",
    "Difference",
    "FrameCut",
    "ModelResult",
    "Ordering",
    "Plan",
    "PlanRun",
    "Predictions",
    "Settings",
    "Signs",
    "Study",
    "Summary",
    "Table",
    "TableProtocol",
    "Trained",
    "advice",
    "compare",
    "comparison_plan",
    "data_source",
    "deploy",
    "make_plan",
    "paired_difference",
    "read_table",
    "recommended",
    "run_plan",
    "summarize",
]

if not TYPE_CHECKING:
    __getattr__ = removed_names(__name__)
