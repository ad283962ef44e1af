r"""The base class of models for a hand."""

from collections.abc import Mapping, Sequence
from typing import Optional, Union

from torch import Tensor
from torch.nn import Module
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.nn._sizes import check_sizes
from torch_geometric_tactile.nn.conv import (
    EdgeAttentionEncoder,
    EdgeFeatureEncoder,
    EdgeMessageEncoder,
)
from torch_geometric_tactile.nn.models._base_model import BaseModel
from torch_geometric_tactile.nn.models._inputs import with_joints
from torch_geometric_tactile.nn.models._taxels import LayoutLike, count_samples, count_taxels
from torch_geometric_tactile.nn.models.pooled_mlp import PooledMLP
from torch_geometric_tactile.nn.models.thread import Thread

# Attribute of the data and default number of features for each input.
_ATTRIBUTES = {"tactile": "x", "edge": "edge_attr", "absolute": "absolute", "position": "pos"}
_CHANNELS = {"tactile": 3, "edge": 4, "absolute": 4, "position": 3}


class TactileModel(BaseModel):
    r"""The base class of models for a hand. It collects the inputs of each taxel from static data,
    PyG batches or single samples. Fully connected layers compute the logits and can also take joint
    angles as inputs.

    The possible inputs are:

    * :obj:`"tactile"`: the readings :obj:`x`;
    * :obj:`"edge"`: the edge features :obj:`edge_attr`, passed through an encoder;
    * :obj:`"absolute"`: the positions and their distance from the hand's origin :obj:`absolute`;
    * :obj:`"position"`: the positions :obj:`pos`.

    A subclass calls :meth:`add_head` and defines :meth:`extract`. A subclass without a graph sets
    the attribute :obj:`needs_edges` to :obj:`False`, so that the data need no edges.

    Args:
        layout (TaxelLayout, int, str or PathLike): The layout, the name of a stock layout, the path
            of a layout file, or the number of taxels.
        out_channels (int): Number of labels or classes :math:`C`.
        inputs (sequence of str): Names of the inputs.
        num_joints (int): Number of joint angles that are appended to the input of the fully
            connected layers, or 0 for none.
        channels (dict, optional): Number of features per taxel for each input that does not have
            the default. The defaults are 3 (:obj:`"tactile"`, :obj:`"position"`) and 4
            (:obj:`"edge"`, :obj:`"absolute"`). For :obj:`"edge"`, the number is both the size of
            the edge features and the output size of the encoder.

    Raises:
        ValueError: If an input is unknown, there is no input, or a size is below one.

    Examples:
        >>> import torch
        >>> class Small(TactileModel):
        ...     needs_edges = False
        ...     def __init__(self):
        ...         super().__init__(4, 2, inputs=("tactile",))  # 4 taxels, 2 classes
        ...         self.add_head(3, (8,), (2,))
        ...     def extract(self, parts, x, edge_index):
        ...         return parts["tactile"]
        >>> Small()(torch.zeros(5, 4, 3)).shape
        torch.Size([5, 2])
    """

    needs_edges: bool = True

    def __init__(
        self,
        layout: LayoutLike,
        out_channels: int,
        *,
        inputs: Sequence[str],
        num_joints: int = 0,
        channels: Optional[Mapping[str, int]] = None,
    ) -> None:
        super().__init__()
        inputs = tuple(inputs)
        unknown_names = [name for name in (*inputs, *(channels or ())) if name not in _ATTRIBUTES]
        if unknown_names or not inputs or len(set(inputs)) < len(inputs):
            raise ValueError(f"'inputs' must be some of {list(_ATTRIBUTES)} (got {inputs})")
        self.num_nodes = count_taxels(layout)
        check_sizes(out_channels=out_channels)
        need(num_joints >= 0, "'num_joints' must not be negative", num_joints)
        self.out_channels = out_channels
        self.inputs = inputs
        self.num_joints = num_joints
        self.channels = {**_CHANNELS, **(channels or {})}
        self.encoder: Optional[Module] = None

    @property
    def modalities(self) -> tuple[str, ...]:
        r"""Names of the attributes of a batch that are passed to :meth:`forward` by keyword, in
        addition to :obj:`x` and :obj:`edge_index`.
        """
        names = [_ATTRIBUTES[name] for name in self.inputs if name != "tactile"]
        return (*names, *super().modalities)

    def add_encoder(self, encoder: Union[str, Module], num_edges: Optional[int]) -> None:
        r"""Adds the encoder of edge features if :obj:`"edge"` is an input.

        Args:
            encoder (str or torch.nn.Module): :obj:`"dense"` (as in the paper), :obj:`"message"`,
                :obj:`"attention"`, or a module that is called as :obj:`encoder(edge_attr,
                edge_index, num_nodes)`.
            num_edges (int, optional): Number of edges. Required for :obj:`"dense"`.
        """
        if "edge" not in self.inputs:
            return
        width = self.channels["edge"]
        self.encoder = _create_encoder(encoder, self.num_nodes, num_edges, width)

    def add_head(self, in_channels: int, widths: Sequence[int], pools: Sequence[int]) -> None:
        r"""Adds the fully connected layers.

        Args:
            in_channels (int): Number of features per taxel before these layers.
            widths (sequence of int): Width of each layer.
            pools (sequence of int): Pool size in channels after each layer.
        """
        width = self.num_nodes * in_channels + self.num_joints
        self.head = PooledMLP(width, self.out_channels, widths, pools)

    def _logits(self, x: Tensor, joint: OptTensor = None, **inputs: OptTensor) -> Tensor:
        rows = self.node_features(x, **inputs).flatten(1)
        return self.head(with_joints(rows, joint, self.num_joints))

    def node_features(
        self,
        x: Tensor,
        edge_index: OptTensor = None,
        edge_attr: OptTensor = None,
        joint: OptTensor = None,
        absolute: OptTensor = None,
        pos: OptTensor = None,
        *,
        thread: Optional[str] = None,
    ) -> Tensor:
        r"""Returns the features of each taxel before the fully connected layers :math:`(B, N, F)`,
        concatenated over all threads. The arguments are the same as for :meth:`forward`, except:

        Args:
            thread (str, optional): Name of an input. Only the thread of this input is computed.
                Requires a model with a thread for each input.
        """
        threads = [name for name in self.inputs if name in getattr(self, "threads", ())]
        if thread is not None and thread not in threads:
            raise ValueError(f"'thread' must be one of {threads} (got '{thread}')")
        names = self.inputs if thread is None else (thread,)
        parts = {
            name: self.collect(name, x, edge_index, edge_attr, absolute, pos) for name in names
        }
        return self.extract(parts, x, edge_index)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the features of each taxel before the fully connected layers :math:`(B, N, F)`.

        Args:
            parts (dict): Inputs of each taxel by name :math:`(B, N, F_m)`.
            x (torch.Tensor): Readings with the shape of the data.
            edge_index (torch.Tensor, optional): Edges of the data.
        """
        raise NotImplementedError

    def collect(
        self,
        name: str,
        x: Tensor,
        edge_index: OptTensor,
        edge_attr: OptTensor,
        absolute: OptTensor,
        pos: OptTensor,
    ) -> Tensor:
        r"""Returns one input of each taxel as :math:`(B, N, F)`.

        Args:
            name (str): Name of the input.
            x, edge_index, edge_attr, absolute, pos: As in :meth:`forward`.

        Raises:
            ValueError: If the input is missing or has the wrong shape.
        """
        num_samples = self.num_samples(x)
        features = {"tactile": x, "edge": edge_attr, "absolute": absolute, "position": pos}[name]
        key, width = _ATTRIBUTES[name], self.channels[name]
        if features is None:
            raise ValueError(f"'{key}' must be given: the model's inputs are {self.inputs}")
        if features.dim() not in (2, 3) or features.size(-1) != width:
            raise ValueError(
                f"'{key}' must have {width} features (got shape {tuple(features.shape)})"
            )
        input_shape = tuple(features.shape)
        if name == "edge":
            assert self.encoder is not None
            num_nodes = self.num_nodes * (num_samples if x.dim() == 2 else 1)
            features = self.encoder(features, edge_index, num_nodes)
        if features.dim() == 2 and features.size(0) == self.num_nodes:
            return features.expand(num_samples, -1, -1)
        return _split_samples(features, num_samples, self.num_nodes, key, input_shape)

    def num_samples(self, x: Tensor) -> int:
        r"""Returns the number of samples in readings.

        Args:
            x (torch.Tensor): Readings :math:`(N, F)`, :math:`(B, N, F)` or the readings of a PyG
                batch.

        Raises:
            ValueError: If the readings do not have as many taxels as the model.
        """
        return count_samples(x, self.num_nodes)

    def convolve(
        self,
        thread: Thread,
        h: Tensor,
        x: Tensor,
        edge_index: OptTensor,
        fixed_edges: bool = False,
    ) -> Tensor:
        r"""Returns the output of a thread for the inputs of each taxel :math:`(B, N, F')`.

        The inputs are passed as a PyG batch if the data are a PyG batch or an explainer is
        attached. Otherwise, they are passed as samples on one topology.

        Args:
            thread (Thread): The thread.
            h (torch.Tensor): Inputs :math:`(B, N, F)`.
            x (torch.Tensor): Readings with the shape of the data.
            edge_index (torch.Tensor): Edges.
            fixed_edges (bool): Whether the edges belong to the model and describe one sample.
                Explainers do not mask such edges.
        """
        num_samples = h.size(0)
        if x.dim() == 3 or fixed_edges or (num_samples == 1 and not thread.explained):
            return thread(h, edge_index)
        return thread(h.flatten(0, 1), edge_index).unflatten(0, (num_samples, self.num_nodes))

    def extra_repr(self) -> str:
        r"""Returns the sizes and inputs for :obj:`repr`."""
        joints = f", num_joints={self.num_joints}" if self.num_joints else ""
        return f"{self.num_nodes}, {self.out_channels}, inputs={self.inputs}{joints}"


def _split_samples(
    features: Tensor, num_samples: int, num_nodes: int, key: str, input_shape: tuple[int, ...]
) -> Tensor:
    # Reshapes features to (B, N, F). `key` and `input_shape` are used in the error message.
    num_rows, num_features = num_nodes * num_samples, features.size(-1)
    has_valid_size = features.size(-2) in (num_nodes, num_rows)
    if not has_valid_size or features.numel() != num_rows * num_features:
        raise ValueError(
            f"'{key}' must have {num_samples} samples of {num_nodes} taxels, like 'x' "
            f"(got shape {input_shape})"
        )
    return features.reshape(num_samples, num_nodes, num_features)


def _create_encoder(
    encoder: Union[str, Module], num_nodes: int, num_edges: Optional[int], width: int
) -> Module:
    r"""Returns an encoder of edge features.

    Args:
        encoder (str or torch.nn.Module): Name of an encoder, or a module that is returned
            unchanged.
        num_nodes (int): Number of taxels :math:`N`.
        num_edges (int, optional): Number of edges. Required by the dense encoder.
        width (int): Size of edge features and of the encoded node features.

    Raises:
        ValueError: If the encoder is unknown, or the dense encoder has no number of edges.
    """
    if isinstance(encoder, Module):
        return encoder
    if encoder == "message":
        return EdgeMessageEncoder(width, width)
    if encoder == "attention":
        return EdgeAttentionEncoder(width, width)
    if encoder != "dense":
        raise ValueError(
            f"'encoder' must be 'dense', 'message', 'attention' or a module (got {encoder!r})"
        )
    if num_edges is None:
        raise ValueError("'num_edges' must be given for the dense encoder (got None)")
    return EdgeFeatureEncoder(num_nodes, num_edges, width, width)
