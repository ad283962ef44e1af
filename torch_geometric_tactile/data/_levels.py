r"""The levels of attributes: a row belongs to a taxel (node), to an edge or to a sample."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

Level = Literal["node", "edge", "sample"]


class AttributeLevel(NamedTuple):
    r"""The level of an attribute of the package or of PyG, and the numbers of dimensions that it
    has if all samples share it. There are no such numbers if it always has a row for each sample.
    """

    level: Level
    ranks: tuple[int, ...] = ()


#: The attributes that need no declaration.
KNOWN_ATTRIBUTES: Mapping[str, AttributeLevel] = {
    "x": AttributeLevel("node", (2,)),
    "pos": AttributeLevel("node", (2,)),
    "normal": AttributeLevel("node", (2,)),
    "tangent": AttributeLevel("node", (3,)),
    "norm": AttributeLevel("node", (2,)),  # PyG's name of the normals
    "absolute": AttributeLevel("node", (2,)),
    "dropped": AttributeLevel("node", (1,)),
    "missing": AttributeLevel("node", (1,)),
    "segment_batch": AttributeLevel("node", (1,)),
    "random_walk_pe": AttributeLevel("node", (2,)),
    "laplacian_eigenvector_pe": AttributeLevel("node", (2,)),
    "edge_index": AttributeLevel("edge", (2,)),
    "adj": AttributeLevel("edge", (2,)),
    "adj_t": AttributeLevel("edge", (2,)),
    "edge_attr": AttributeLevel("edge", (1, 2)),
    "edge_weight": AttributeLevel("edge", (1,)),
    "edge_type": AttributeLevel("edge", (1,)),
    "edge_sector": AttributeLevel("edge", (1,)),
    "edge_is_within": AttributeLevel("edge", (1,)),
    "y": AttributeLevel("sample"),
    "joint": AttributeLevel("sample"),
    "action": AttributeLevel("sample"),
    "time": AttributeLevel("sample"),
    "trial": AttributeLevel("sample"),
    "group": AttributeLevel("sample"),
    "session": AttributeLevel("sample"),
    "property": AttributeLevel("sample"),
    "phase": AttributeLevel("sample"),
}
#: The attributes of the topology, which all samples share.
TOPOLOGY = ("edge_index", "adj", "adj_t")
#: Attributes whose numbers have names, and the kind of these names. For example, the names of the
#: numbers in :obj:`y` are the :obj:`class_names` of a data set.
NAMED = {"y": "class", "group": "group", "session": "session"}
_BATCH_ATTRIBUTES = ("batch", "ptr")


@dataclass(frozen=True)
class Schema:
    r"""The levels that a user declares for attributes, in addition to :obj:`KNOWN_ATTRIBUTES`.

    A declaration takes precedence over :obj:`KNOWN_ATTRIBUTES`.
    """

    node: frozenset[str] = frozenset()
    edge: frozenset[str] = frozenset()
    shared: frozenset[str] = frozenset()

    @classmethod
    def from_names(
        cls, node: Iterable[str] = (), edge: Iterable[str] = (), shared: Iterable[str] = ()
    ) -> "Schema":
        r"""Checks the names of attributes and returns their schema.

        Args:
            node (iterable of str): Names of attributes with a row for each taxel.
            edge (iterable of str): Names of attributes with a row for each edge.
            shared (iterable of str): Names of attributes with one value for all samples.

        Raises:
            ValueError: If an argument is not a list of names, an attribute is declared twice, or
                its level is fixed.
        """
        names = {}
        for argument, value in (("node", node), ("edge", edge), ("shared", shared)):
            name_list = None if isinstance(value, str) else list(value)
            if name_list is None or not all(isinstance(name, str) for name in name_list):
                raise ValueError(f"'{argument}' must be a list of names (got {value!r})")
            names[argument] = frozenset(name_list)
        duplicates = sorted(names["node"] & names["edge"])
        if duplicates:
            raise ValueError(f"'{duplicates[0]}' must be named in 'node' or in 'edge' (got both)")
        for argument, fixed_names in (
            ("node", ("x", *TOPOLOGY, *_BATCH_ATTRIBUTES)),
            ("edge", ("x", *TOPOLOGY, *_BATCH_ATTRIBUTES)),
            ("shared", ("x", *_BATCH_ATTRIBUTES)),
        ):
            for name in fixed_names:
                if name in names[argument]:
                    raise ValueError(
                        f"'{argument}' must not name attributes of a fixed level (got '{name}')"
                    )
        return cls(**names)

    def update(self, schema: "Schema") -> "Schema":
        r"""Returns this schema with the declarations of another schema, which take precedence."""
        names = schema.node | schema.edge | schema.shared
        return Schema(
            (self.node - names) | schema.node,
            (self.edge - names) | schema.edge,
            (self.shared - names) | schema.shared,
        )

    def to_dict(self) -> dict[str, list[str]]:
        r"""Returns the names as sorted lists."""
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
        default = KNOWN_ATTRIBUTES.get(key)
        return "sample" if default is None else default.level

    def is_shared(self, key: str, value: Any) -> bool:
        r"""Returns whether all samples share one value of an attribute."""
        if key in self.shared or not isinstance(value, Tensor):
            return True
        if key == "x" or key in self.node or key in self.edge:
            return False
        default = KNOWN_ATTRIBUTES.get(key)
        if default is None or not default.ranks:
            return False
        return key in TOPOLOGY or value.dim() in default.ranks

    def num_samples(self, attributes: Mapping[str, Any]) -> int | None:
        r"""Returns the number of samples, or :obj:`None` if no attribute has a row for each."""
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
        r"""Checks the value of an attribute against its level and the other attributes.

        Args:
            key (str): Name of the attribute.
            value (Any): The new value.
            attributes (Mapping): All attributes, which may include the present value of this one.
            num_samples (int, optional): The number of samples that a new attribute must have if no
                other attribute has a row for each sample.

        Raises:
            ValueError: If the type or the shape does not fit.
        """
        if key in _BATCH_ATTRIBUTES:
            raise ValueError(f"StaticData has no '{key}': call 'to_batch()' for a PyG batch")
        if not isinstance(value, Tensor):
            self._check_plain_value(key, value)
            return
        other_attributes = {name: item for name, item in attributes.items() if name != key}
        self._check_dims(key, value)
        if not self.is_shared(key, value):
            # A replacement of the only attribute with a row for each sample may have more or fewer
            # samples.
            self._check_rows(
                key, value, other_attributes, None if key in attributes else num_samples
            )
        self._check_elements(key, value, other_attributes)
        is_new = attributes.get(key) is None
        if is_new and key in ("x", "edge_index"):
            # Not checked for a replacement: the caller may replace the other attributes afterwards.
            for name, item in other_attributes.items():
                self._check_elements(name, item, {key: value})

    def _check_plain_value(self, key: str, value: Any) -> None:
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
        default = KNOWN_ATTRIBUTES.get(key)
        if default is None or not default.ranks or key in self.shared:
            return
        if value.dim() not in (*default.ranks, default.ranks[-1] + 1):
            ranks = " or ".join(map(str, default.ranks))
            raise ValueError(
                f"'{key}' must have {ranks} dimensions if all samples share it, or "
                f"{default.ranks[-1] + 1} if it has a row for each sample (got shape {shape}); "
                f"name it in '{default.level}' to declare another shape"
            )

    def _check_rows(
        self, key: str, value: Tensor, other_attributes: Mapping[str, Any], expected: int | None
    ) -> None:
        # The rows of other attributes are compared first; `expected` is used if there are none.
        if key == "x":
            other_attributes = {
                k: v for k, v in other_attributes.items() if not self.is_shared(k, v)
            }
        num_samples = self.num_samples(other_attributes)
        num_samples = expected if num_samples is None else num_samples
        if value.dim() > 0 and num_samples in (None, value.size(0)):
            return
        shape = tuple(value.shape)
        if key == "x":
            source = f"'{next(iter(other_attributes))}' has" if other_attributes else "declared"
            raise ValueError(
                f"'x' must have {num_samples} samples, as {source} (got shape {shape}); use "
                "'index_select' to select samples"
            )
        level = self.level(key)
        if level != "sample":
            advice = f"if all samples share it, name it in '{level}' and in 'shared'"
        elif key in KNOWN_ATTRIBUTES:
            advice = "name it in 'shared' if it is one value for all samples"
        else:
            advice = (
                "name it in 'node' or 'edge' if it has a row for each taxel or edge, and in "
                "'shared' if it is the same for all samples"
            )
        rows = "a row" if num_samples is None else f"{num_samples} rows, one"
        raise ValueError(f"'{key}' must have {rows} for each sample (got shape {shape}); {advice}")

    def _check_elements(self, key: str, value: Any, attributes: Mapping[str, Any]) -> None:
        # Checks the number of taxels or edges, which other attributes determine.
        level = self.level(key)
        if level == "sample" or not isinstance(value, Tensor) or key in ("x", *TOPOLOGY):
            return
        num_elements = self._num_nodes(attributes) if level == "node" else _num_edges(attributes)
        dim = 0 if self.is_shared(key, value) else 1
        if num_elements is not None and value.size(dim) != num_elements:
            element = "taxels" if level == "node" else "edges"
            raise ValueError(
                f"'{key}' must have {num_elements} {element} in its dimension {dim} "
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
    r"""Converts indices or a mask of samples to one-dimensional indices, as PyG's data sets do.

    Raises:
        IndexError: If :obj:`index` holds neither integers nor truth values.
    """
    try:
        flat = torch.as_tensor(index).flatten()
    except (RuntimeError, TypeError, ValueError) as error:
        raise IndexError(
            f"'index' must be a slice, integers or a mask (got {index!r:.80})"
        ) from error
    if flat.dtype == torch.bool:
        return flat.nonzero().view(-1)
    if flat.numel() and (flat.is_floating_point() or flat.is_complex()):
        raise IndexError(f"'index' must hold integers or truth values (got {flat.dtype})")
    return flat.long()
