r"""What an attribute belongs to: a taxel, an edge or a sample."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

Level = Literal["node", "edge", "sample"]


class Known(NamedTuple):
    r"""What is known of an attribute by its name."""

    level: Level
    ranks: tuple[int, ...] = ()


#: The attributes that need no declaration.
KNOWN_ATTRIBUTES: Mapping[str, Known] = {
    "x": Known("node", (2,)),
    "pos": Known("node", (2,)),
    "normal": Known("node", (2,)),
    "tangent": Known("node", (3,)),
    "norm": Known("node", (2,)),  # PyG's name of the normals
    "absolute": Known("node", (2,)),
    "dropped": Known("node", (1,)),
    "missing": Known("node", (1,)),
    "segment_batch": Known("node", (1,)),
    "random_walk_pe": Known("node", (2,)),
    "laplacian_eigenvector_pe": Known("node", (2,)),
    "edge_index": Known("edge", (2,)),
    "adj": Known("edge", (2,)),
    "adj_t": Known("edge", (2,)),
    "edge_attr": Known("edge", (1, 2)),
    "edge_weight": Known("edge", (1,)),
    "edge_type": Known("edge", (1,)),
    "edge_sector": Known("edge", (1,)),
    "edge_is_within": Known("edge", (1,)),
    "y": Known("sample"),
    "joint": Known("sample"),
    "time": Known("sample"),
    "trial": Known("sample"),
    "group": Known("sample"),
    "session": Known("sample"),
    "property": Known("sample"),
    "phase": Known("sample"),
}
#: The topology, never one for each sample.
TOPOLOGY = ("edge_index", "adj", "adj_t")
#: What the numbers of an attribute have names for: those of :obj:`y` are `class_names`.
NAMED = {"y": "class", "group": "group", "session": "session"}
_OF_A_BATCH = ("batch", "ptr")


@dataclass(frozen=True)
class Schema:
    r"""The declared levels of a user's own attributes, in addition to :obj:`KNOWN_ATTRIBUTES`.

    A declaration takes precedence over what is known of a name.
    """

    node: frozenset[str] = frozenset()
    edge: frozenset[str] = frozenset()
    shared: frozenset[str] = frozenset()

    @classmethod
    def of(
        cls, node: Iterable[str] = (), edge: Iterable[str] = (), shared: Iterable[str] = ()
    ) -> "Schema":
        r"""Checks the names and returns their schema."""
        names = {}
        for argument, given in (("node", node), ("edge", edge), ("shared", shared)):
            listed = None if isinstance(given, str) else list(given)
            if listed is None or not all(isinstance(name, str) for name in listed):
                raise ValueError(f"'{argument}' must be a list of names (got {given!r})")
            names[argument] = frozenset(listed)
        twice = sorted(names["node"] & names["edge"])
        if twice:
            raise ValueError(f"'{twice[0]}' must be named in 'node' or in 'edge' (got both)")
        for argument, fixed in (
            ("node", ("x", *TOPOLOGY, *_OF_A_BATCH)),
            ("edge", ("x", *TOPOLOGY, *_OF_A_BATCH)),
            ("shared", ("x", *_OF_A_BATCH)),
        ):
            for name in fixed:
                if name in names[argument]:
                    raise ValueError(f"'{argument}' must name other attributes (got '{name}')")
        return cls(**names)

    def update(self, other: "Schema") -> "Schema":
        r"""Returns the schema with the names in :obj:`other` declared as they are there."""
        named = other.node | other.edge | other.shared
        return Schema(
            (self.node - named) | other.node,
            (self.edge - named) | other.edge,
            (self.shared - named) | other.shared,
        )

    def to_dict(self) -> dict[str, list[str]]:
        r"""Returns the names as lists, sorted."""
        return {
            "node": sorted(self.node),
            "edge": sorted(self.edge),
            "shared": sorted(self.shared),
        }

    def level(self, key: str) -> Level:
        r"""Returns the level of an attribute."""
        if key in self.node:
            return "node"
        if key in self.edge:
            return "edge"
        known = KNOWN_ATTRIBUTES.get(key)
        return "sample" if known is None else known.level

    def is_shared(self, key: str, value: Any) -> bool:
        r"""Tells whether all samples share one value of an attribute."""
        if key in self.shared or not isinstance(value, Tensor):
            return True
        if key == "x" or key in self.node or key in self.edge:
            return False
        known = KNOWN_ATTRIBUTES.get(key)
        if known is None or not known.ranks:
            return False
        return key in TOPOLOGY or value.dim() in known.ranks

    def num_samples(self, attributes: Mapping[str, Any]) -> int | None:
        r"""Returns the number of samples, or :obj:`None` if no attribute tells."""
        x = attributes.get("x")
        if isinstance(x, Tensor):
            return x.size(0)
        for key, value in attributes.items():
            if not self.is_shared(key, value):
                return int(value.size(0))
        return None

    def check(
        self, key: str, value: Any, attributes: Mapping[str, Any], num_samples: int | None = None
    ) -> None:
        r"""Checks a value against its level and the other attributes, and a new one against the
        number of samples, if that was stated.
        """
        if key in _OF_A_BATCH:
            raise ValueError(f"StaticData has no '{key}': call 'to_batch()' for a PyG batch")
        if not isinstance(value, Tensor):
            self._check_plain(key, value)
            return
        others = {name: other for name, other in attributes.items() if name != key}
        self._check_dims(key, value)
        if not self.is_shared(key, value):
            # What replaces the only attribute with rows may have another number of them.
            self._check_rows(key, value, others, None if key in attributes else num_samples)
        self._check_elements(key, value, others)
        first = attributes.get(key) is None
        if first and key in ("x", "edge_index"):
            # A replaced one may be followed by the attributes that have to change with it.
            for name, other in others.items():
                self._check_elements(name, other, {key: value})

    def _check_plain(self, key: str, value: Any) -> None:
        declared = key in self.node or key in self.edge
        if declared or (key in KNOWN_ATTRIBUTES and key not in (*self.shared, "adj", "adj_t")):
            raise ValueError(f"'{key}' must be a tensor (got {type(value).__name__})")
        if isinstance(value, (list, tuple, np.ndarray)) and key not in self.shared:
            raise ValueError(
                f"'{key}' must be a tensor with a row for each sample, or be named in 'shared' "
                f"(got {type(value).__name__})"
            )

    def _check_dims(self, key: str, value: Tensor) -> None:
        shape = tuple(value.shape)
        if key == "x" and value.dim() != 3:
            raise ValueError(
                f"'x' must have shape (num_samples, num_nodes, num_features) (got {shape})"
            )
        if key == "edge_index" and (value.dim() != 2 or value.size(0) != 2):
            raise ValueError(
                f"'edge_index' must have shape (2, num_edges), the same for all samples "
                f"(got {shape})"
            )
        if key in self.node or key in self.edge:
            rows = ["taxel" if key in self.node else "edge"]
            rows = rows if key in self.shared else ["sample", *rows]
            if value.dim() < len(rows):
                raise ValueError(
                    f"'{key}' must have a dimension for each {' and each '.join(rows)} "
                    f"(got shape {shape})"
                )
            return
        known = KNOWN_ATTRIBUTES.get(key)
        if known is None or not known.ranks or key in self.shared:
            return
        if value.dim() not in (*known.ranks, known.ranks[-1] + 1):
            shared = " or ".join(map(str, known.ranks))
            raise ValueError(
                f"'{key}' must have {shared} dimensions if all samples share it, or "
                f"{known.ranks[-1] + 1} if each has its own (got shape {shape}); name it in "
                f"'{known.level}' to declare another shape"
            )

    def _check_rows(
        self, key: str, value: Tensor, others: Mapping[str, Any], stored: int | None
    ) -> None:
        if key == "x":  # all others have to agree with it
            others = {k: v for k, v in others.items() if not self.is_shared(k, v)}
        num_samples = self.num_samples(others)
        num_samples = stored if num_samples is None else num_samples
        if value.dim() > 0 and num_samples in (None, value.size(0)):
            return
        shape = tuple(value.shape)
        if key == "x":
            source = f"'{next(iter(others))}' has" if others else "these data have"
            raise ValueError(
                f"'x' must have {num_samples} samples, as {source} (got shape {shape}); use "
                "'index_select' to choose samples"
            )
        level = self.level(key)
        if level != "sample":
            advice = f"if all share it, name it in '{level}' and in 'shared'"
        elif key in KNOWN_ATTRIBUTES:
            advice = "name it in 'shared' if it is one value for all"
        else:
            advice = (
                "name it in 'node' or 'edge' if it has a row for each taxel or edge, and in "
                "'shared' if it is the same for all"
            )
        rows = "a row" if num_samples is None else f"{num_samples} rows, one"
        raise ValueError(f"'{key}' must have {rows} for each sample (got shape {shape}); {advice}")

    def _check_elements(self, key: str, value: Any, others: Mapping[str, Any]) -> None:
        level = self.level(key)
        if level == "sample" or not isinstance(value, Tensor) or key in ("x", *TOPOLOGY):
            return
        wanted = self._num_nodes(others) if level == "node" else _num_edges(others)
        dim = 0 if self.is_shared(key, value) else 1
        if wanted is not None and value.size(dim) != wanted:
            what = "taxels" if level == "node" else "edges"
            raise ValueError(
                f"'{key}' must have {wanted} {what} in its dimension {dim} "
                f"(got shape {tuple(value.shape)}); name it in '{level}', or in '{level}' and "
                "'shared', to declare another shape"
            )

    def _num_nodes(self, attributes: Mapping[str, Any]) -> int | None:
        for key in ("x", "pos"):
            value = attributes.get(key)
            if isinstance(value, Tensor) and key not in self.node and key not in self.shared:
                return value.size(-2)
        num_nodes = attributes.get("num_nodes")
        return num_nodes if isinstance(num_nodes, int) else None


def _num_edges(attributes: Mapping[str, Any]) -> int | None:
    edge_index = attributes.get("edge_index")
    return edge_index.size(1) if isinstance(edge_index, Tensor) else None


def flat_index(index: Any) -> Tensor:
    r"""Returns indices of samples in one dimension, also of a mask, as PyG reads them."""
    try:
        found = torch.as_tensor(index).flatten()
    except (RuntimeError, TypeError, ValueError) as error:
        raise IndexError(
            f"'index' must be a slice, integers or a mask (got {index!r:.80})"
        ) from error
    if found.dtype == torch.bool:
        return found.nonzero().view(-1)
    if found.numel() and (found.is_floating_point() or found.is_complex()):
        raise IndexError(f"'index' must hold integers or truth values (got {found.dtype})")
    return found.long()
