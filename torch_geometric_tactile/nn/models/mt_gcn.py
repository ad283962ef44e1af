r"""A network with a thread of graph convolutions for each input."""

from collections.abc import Mapping, Sequence
from typing import Any, Optional, Union

import torch
from torch import Tensor
from torch.nn import Module, ModuleDict
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models._inputs import concatenate_inputs
from torch_geometric_tactile.nn.models._taxels import LayoutLike, load_layout
from torch_geometric_tactile.nn.models._thread_widths import thread_settings
from torch_geometric_tactile.nn.models.gcn_thread import GCNThread
from torch_geometric_tactile.nn.models.tactile_model import TactileModel
from torch_geometric_tactile.sensors._checks import check_edges


class MTGCN(TactileModel):
    r"""The MT-GCN from the "Tactile Object Property Recognition using Geometrical Graph Edge
    Features and Multi-Thread Graph Convolutional Network" paper (:doc:`P1 </papers>`). It has one
    :class:`~torch_geometric_tactile.nn.models.GCNThread` for each input. The features of the
    threads are concatenated before the fully connected layers.

    .. math::
        \mathbf{H} = \left( f_1(\mathbf{H}_1, \mathbf{A}_1), \ldots,
        f_M(\mathbf{H}_M, \mathbf{A}_M) \right)

    The defaults follow the paper: "14, 28, 56(P)28, 112(P)28, 112(P)7" for readings and "7, 14,
    28(P)14, 28(P)14, 56(P)7" for all other inputs. The paper's table gives 28 as the last number.
    This contradicts the stated input of the fully connected layers, which is :math:`384 \cdot 7`
    per thread.

    Args:
        layout (TaxelLayout, int, str or PathLike): The layout, the name of a stock layout, the path
            of a layout file, or the number of taxels. A layout is required if an adjacency is
            selected by name.
        out_channels (int): Number of labels or classes :math:`C`.
        inputs (sequence of str): Inputs to use: any of :obj:`"tactile"`, :obj:`"edge"`,
            :obj:`"absolute"` and :obj:`"position"`. Each input has a thread. The threads are
            concatenated in this order.
        threads (dict, optional): Settings of the threads by input, to override the paper's values.
            Each value is a dictionary with :obj:`widths`, :obj:`pools` and :obj:`adjacency`, all
            optional. An :obj:`adjacency` consists of edges :math:`(2, |\mathcal{E}_m|)` (a tensor
            or lists), or is the name of an adjacency of the layout. It replaces the edges of the
            data. PyG's explainers do not explain it.
        num_edges (int, optional): Number of edges. Required by the dense encoder of :obj:`"edge"`.
        num_joints (int): Number of joint angles, 16 for an Allegro hand, or 0 for none.
        channels (dict, optional): Number of features per taxel by input, for inputs that differ
            from the default (3 or 4).
        encoder (str or torch.nn.Module): Encoder of edge features: :obj:`"dense"` (as in the
            paper), :obj:`"message"`, :obj:`"attention"` or a module.
        head_widths (sequence of int): Width of each fully connected layer.
        head_pools (sequence of int): Pool size in channels after each fully connected layer.
        fast (bool): Whether to use a faster implementation for batches of at least eight samples on
            a CPU. It returns the same results, but does not support second derivatives.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`, edges :math:`(2, |\mathcal{E}|)`; further inputs as in
          :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If an input is unknown, is missing or has the wrong shape, or if an adjacency
            has indices out of range.

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
        if any(isinstance(setting.get("adjacency"), str) for setting in settings.values()):
            layout = load_layout(layout, "an adjacency by name")
        super().__init__(
            layout, out_channels, inputs=inputs, num_joints=num_joints, channels=channels
        )
        self.add_encoder(encoder, num_edges)
        have_adjacency = [setting.get("adjacency") is not None for setting in settings.values()]
        self.needs_edges = "edge" in self.inputs or not all(have_adjacency)
        self.threads, width = ModuleDict(), 0
        for name, setting in settings.items():
            thread = GCNThread(self.channels[name], setting["widths"], setting["pools"], fast=fast)
            adjacency = setting.get("adjacency")
            if isinstance(adjacency, str):
                adjacency = load_layout(layout, "an adjacency by name").edge_index(adjacency)
            if adjacency is not None:
                adjacency = _checked_edges(name, adjacency, self.num_nodes)
                for conv, _ in thread.layers():
                    conv.explain = False  # an explainer's mask applies to the edges of the data
            # Not saved in the state, so that a checkpoint cannot override the argument.
            self.register_buffer(f"{name}_edge_index", adjacency, persistent=False)
            self.threads[name] = thread
            width += thread.out_channels
        self.add_head(width, head_widths, head_pools)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the features of each taxel before the fully connected layers
        :math:`(B, N, F)`.
        """
        outs = {}
        for name, features in parts.items():
            thread, thread_edges = self.threads[name], getattr(self, f"{name}_edge_index")
            assert isinstance(thread, GCNThread)
            edges = edge_index if thread_edges is None else thread_edges
            outs[name] = self.convolve(thread, features, x, edges, thread_edges is not None)
        return concatenate_inputs(outs)


def _checked_edges(
    name: str, edges: Union[Sequence[Sequence[int]], Tensor], num_nodes: int
) -> Tensor:
    r"""Returns the edges of a thread's adjacency as a tensor :math:`(2, |\mathcal{E}_m|)`.

    Args:
        name (str): Input of the thread, for error messages.
        edges (sequence or torch.Tensor): Edges.
        num_nodes (int): Number of taxels :math:`N`.

    Raises:
        ValueError: If the edges have the wrong shape or indices out of range.
    """
    edges = torch.as_tensor(edges, device="cpu")  # values cannot be checked on the meta device
    return check_edges(edges, num_nodes, f"the adjacency of '{name}'")
