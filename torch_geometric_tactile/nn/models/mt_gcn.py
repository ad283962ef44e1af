r"""A thread of graph convolutions for each input."""

from collections.abc import Mapping, Sequence
from typing import Any, Optional, Union

import torch
from torch import Tensor
from torch.nn import Module, ModuleDict
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models._inputs import side_by_side
from torch_geometric_tactile.nn.models._taxels import LayoutLike, load_layout
from torch_geometric_tactile.nn.models._thread_widths import thread_settings
from torch_geometric_tactile.nn.models.gcn_thread import GCNThread
from torch_geometric_tactile.nn.models.tactile_model import TactileModel
from torch_geometric_tactile.sensors import check_edges


class MTGCN(TactileModel):
    r"""The MT-GCN of the "Tactile Object Property Recognition using Geometrical Graph Edge Features
    and Multi-Thread Graph Convolutional Network" paper (:doc:`P1 </papers>`): a
    :class:`~torch_geometric_tactile.nn.models.GCNThread` for each input, whose features are
    concatenated before the fully connected layers.

    .. math::
        \mathbf{H} = \left( f_1(\mathbf{H}_1, \mathbf{A}_1), \ldots,
        f_M(\mathbf{H}_M, \mathbf{A}_M) \right)

    The defaults are the paper's: "14, 28, 56(P)28, 112(P)28, 112(P)7" for readings and "7, 14,
    28(P)14, 28(P)14, 56(P)7" for all other inputs. (The table prints 28 for the last number, which
    does not give the printed input of the fully connected layers, :math:`384 \cdot 7` a thread.)

    Args:
        layout (TaxelLayout, int, str or PathLike): The layout, the name of a stock layout, the path
            of a layout file, or the number of taxels. Named adjacencies need a layout.
        out_channels (int): Number of labels or classes :math:`C`.
        inputs (sequence of str): Some of :obj:`"tactile"`, :obj:`"edge"`, :obj:`"absolute"` and
            :obj:`"position"`; each gets a thread, in this order.
        threads (dict, optional): The settings of a thread by input, if not the paper's:
            :obj:`widths`, :obj:`pools`, and :obj:`adjacency`, edges :math:`(2, |\mathcal{E}_m|)` (a
            tensor or lists) or their name in the layout, which replace the data's; PyG's explainers
            then say nothing about the edges of this thread.
        num_edges (int, optional): Number of edges, for the dense encoder of :obj:`"edge"`.
        num_joints (int): Number of joint angles; 16 for an Allegro hand, 0 for none.
        channels (dict, optional): Features of a taxel by input, if not 3 or 4.
        encoder (str or torch.nn.Module): The encoder of edge features: :obj:`"dense"` is the
            paper's; :obj:`"message"` and :obj:`"attention"` are ours.
        head_widths (sequence of int): Width of each fully connected layer.
        head_pools (sequence of int): How many channels share one maximum, after each of them.
        fast (bool): Whether to compute batches of eight samples and more on a processor with the
            operations of :mod:`torch_geometric_tactile.nn._pooled_gcn`. They give the same numbers,
            but have no second derivative.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch
          :math:`(B \cdot N, F)`, edges :math:`(2, |\mathcal{E}|)`; further inputs as in
          :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If an input is unknown or missing, or has another shape, or an adjacency joins
            other taxels.

    Examples:
        >>> model = MTGCN(inputs=("tactile", "edge"), num_edges=1401, num_joints=16)
        >>> model
        MTGCN(384, 6, inputs=('tactile', 'edge'), num_joints=16)
        >>> model.head.in_channels
        5392
    """

    def __init__(
        self,
        layout: LayoutLike = "allegro_uskin",
        out_channels: int = 6,
        *,
        inputs: Sequence[str] = ("tactile", "edge"),
        threads: Optional[Mapping[str, Any]] = None,
        num_edges: Optional[int] = None,
        num_joints: int = 0,
        channels: Optional[Mapping[str, int]] = None,
        encoder: Union[str, Module] = "dense",
        head_widths: Sequence[int] = (1536, 384, 96),
        head_pools: Sequence[int] = (2, 2, 2),
        fast: bool = True,
    ) -> None:
        settings = thread_settings(inputs, threads, ("widths", "pools", "adjacency"))
        if any(isinstance(own.get("adjacency"), str) for own in settings.values()):
            layout = load_layout(layout, "an adjacency by name")
        super().__init__(
            layout, out_channels, inputs=inputs, num_joints=num_joints, channels=channels
        )
        self.add_encoder(encoder, num_edges)
        own_edges = [own.get("adjacency") is not None for own in settings.values()]
        self.needs_edges = "edge" in self.inputs or not all(own_edges)
        self.threads, width = ModuleDict(), 0
        for name, own in settings.items():
            thread = GCNThread(self.channels[name], own["widths"], own["pools"], fast=fast)
            adjacency = own.get("adjacency")
            if isinstance(adjacency, str):
                adjacency = load_layout(layout, "an adjacency by name").edge_index(adjacency)
            if adjacency is not None:
                adjacency = _checked_edges(name, adjacency, self.num_nodes)
                for conv, _ in thread.layers():
                    conv.explain = False  # an explainer's mask is of the data's edges
            # Not in the state: it is an argument, and a checkpoint must not overrule it.
            self.register_buffer(f"{name}_edge_index", adjacency, persistent=False)
            self.threads[name] = thread
            width += thread.out_channels
        self.add_head(width, head_widths, head_pools)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the features of each taxel before the fully connected layers."""
        outs = {}
        for name, part in parts.items():
            thread, own = self.threads[name], getattr(self, f"{name}_edge_index")
            assert isinstance(thread, GCNThread)
            edges = edge_index if own is None else own
            outs[name] = self.convolve(thread, part, x, edges, own is not None)
        return side_by_side(outs)


def _checked_edges(
    name: str, edges: Union[Sequence[Sequence[int]], Tensor], num_nodes: int
) -> Tensor:
    r"""Returns the edges of a thread's own :math:`(2, |\mathcal{E}_m|)`.

    Shapes:
        - **num_nodes:** Number of taxels :math:`N`.
    """
    edges = torch.as_tensor(edges, device="cpu")  # to be checked
    return check_edges(edges, num_nodes, f"the adjacency of '{name}'")
