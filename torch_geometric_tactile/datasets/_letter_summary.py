r"""Summary statistics of the letters of a data set."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import torch
from torch_geometric.data.summary import Stats, Summary

if TYPE_CHECKING:
    from torch_geometric_tactile.datasets.letter_shape import LetterShape


@dataclass(repr=False, kw_only=True)
class LetterSummary(Summary):
    r"""PyG's summary of a data set, with the numbers of letters and presses."""

    num_presses: int
    copies: int
    num_samples_per_letter: dict[str, int]
    num_presses_per_letter: dict[str, int]
    left_out: list[str]
    synthetic: bool

    @classmethod
    def from_letters(cls, dataset: "LetterShape") -> Self:
        r"""Collects the summary of a selection. Samples are not loaded one by one, since all have
        the same numbers of nodes and edges.
        """
        y, trial = dataset.column("y"), dataset.column("trial")
        assert y is not None
        assert trial is not None
        presses = torch.stack([trial, y]).unique(dim=1)
        num_classes = len(dataset.class_names)
        num_edges = 0 if dataset._data.edge_index is None else dataset._data.edge_index.size(1)
        return cls(
            name=type(dataset).__name__,
            num_graphs=len(dataset),
            num_nodes=_constant_stats(dataset.layout.num_taxels),
            num_edges=_constant_stats(num_edges),
            num_presses=presses.size(1),
            copies=dataset.copies,
            num_samples_per_letter=_counts(y.bincount(minlength=num_classes), dataset.class_names),
            num_presses_per_letter=_counts(
                presses[1].bincount(minlength=num_classes), dataset.class_names
            ),
            left_out=dataset.left_out,
            synthetic=dataset.synthetic,
        )

    def format(self, fmt: str = "psql") -> str:
        r"""Formats the summary as lines of text."""
        origin = "simulated" if self.synthetic else "recorded"
        letters = ", ".join(
            f"{name} {count} ({self.num_presses_per_letter[name]})"
            for name, count in self.num_samples_per_letter.items()
        )
        return (
            f"{self.name} (#graphs={self.num_graphs}): {self.num_presses} {origin} presses, stored "
            f"{self.copies} times\n"
            f"#nodes={self.num_nodes.mean:.0f}, #edges={self.num_edges.mean:.0f}\n"
            f"samples (presses) of each letter: {letters}\n"
            f"files or matrices left out: {len(self.left_out)}"
        )


def _counts(counts: Any, names: list[str]) -> dict[str, int]:
    return dict(zip(names, counts.tolist(), strict=True))


def _constant_stats(value: int) -> Stats:
    number = float(value)
    return Stats(number, 0.0, number, number, number, number, number)
