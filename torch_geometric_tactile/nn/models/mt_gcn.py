r"""A thread of graph convolutions for each input."""

from collections.abc import Mapping, Sequence
from typing import Any, Optional, Union

import torch
from torch import Tensor
from torch.nn import Module, ModuleDict
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models.gcn_thread import POOLS, WIDTHS, GCNThread
from torch_geometric_tactile.nn.models.tactile_model import TactileModel, as_layout
from torch_geometric_tactile.sensors import TaxelLayout

# The threads of the paper: of the readings, and of all else.
TACTILE_THREAD: dict[str, Any] = {"widths": WIDTHS, "pools": POOLS}
OTHER_THREAD: dict[str, Any] = {"widths": (7, 14, 28, 28, 56), "pools": (1, 1, 2, 2, 8)}
_THREAD_KEYS = ("widths", "pools", "adjacency")


class MTGCN(TactileModel):
    r"""The MT-GCN of the "Tactile Object Property Recognition using Geometrical Graph Edge Features
    and Multi-Thread Graph Convolutional Network" paper: a
    :class:`~torch_geometric_tactile.nn.models.GCNThread` for each input, whose features stand side
    by side before the fully connected layers.

    .. math::
        \mathbf{H} = \left( f_1(\mathbf{H}_1, \mathbf{A}_1), \ldots,
        f_M(\mathbf{H}_M, \mathbf{A}_M) \right)

    The defaults are the paper's: "14, 28, 56(P)28, 112(P)28, 112(P)7" for readings and "7, 14,
    28(P)14, 28(P)14, 56(P)7" for all else. (The table prints 28 for the last number, which does not
    give the printed input of the fully connected layers, :math:`384 \cdot 7` a thread.)

    Args:
        num_nodes (int): Number of taxels :math:`N`.
        out_channels (int): Number of labels or classes :math:`C`.
        threads (dict or sequence of str): For each input, what its thread has of its own:
            :obj:`widths`, :obj:`pools`, and :obj:`adjacency`, edges :math:`(2, |\mathcal{E}_m|)` or
            their name in the layout, instead of the data's.
        num_edges (int, optional): Number of edges, for the dense encoder of :obj:`"edge"`.
        num_joints (int): Number of joint angles; 16 for an Allegro hand, 0 for none.
        head_widths (sequence of int): Width of each fully connected layer.
        head_pools (sequence of int): How many channels share one maximum, behind each of them.
        encoder (str or torch.nn.Module): The encoder of edge features: :obj:`"dense"` is the
            paper's; :obj:`"message"` and :obj:`"attention"` are ours.
        channels (dict, optional): Features of a taxel by input, where they are not 3 or 4.
        layout (TaxelLayout or str): Where an adjacency that is named is looked up.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch
          :math:`(B \cdot N, F)`, edges :math:`(2, |\mathcal{E}|)`; further inputs as
          :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward` says
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If an input is unknown or missing, or has another shape.

    Examples:
        >>> model = MTGCN(threads={"tactile": {}, "edge": {}}, num_edges=1401, num_joints=16)
        >>> model
        MTGCN(384, 6, inputs=('tactile', 'edge'), num_joints=16)
        >>> model.head.in_channels
        5392
    """

    def __init__(
        self,
        num_nodes: int = 384,
        out_channels: int = 6,
        threads: Union[Mapping[str, Any], Sequence[str]] = ("tactile", "edge"),
        num_edges: Optional[int] = None,
        num_joints: int = 0,
        head_widths: Sequence[int] = (1536, 384, 96),
        head_pools: Sequence[int] = (2, 2, 2),
        encoder: Union[str, Module] = "dense",
        channels: Optional[dict[str, int]] = None,
        layout: Union[TaxelLayout, str] = "allegro_uskin",
    ) -> None:
        specs = thread_specs(threads, _THREAD_KEYS)
        super().__init__(num_nodes, out_channels, tuple(specs), num_joints, channels)
        self.add_encoder(encoder, num_edges)
        self.threads, width = ModuleDict(), 0
        for name, spec in specs.items():
            thread = GCNThread(self.channels[name], spec["widths"], spec["pools"])
            adjacency = spec.get("adjacency")
            if isinstance(adjacency, str):
                adjacency = as_layout(layout).edge_index(adjacency)
            # Not in the state: it is an argument, and a checkpoint must not overrule it.
            self.register_buffer(f"{name}_edge_index", adjacency, persistent=False)
            self.threads[name] = thread
            width += thread.out_channels
        self.add_head(width, head_widths, head_pools)

    def node_features(
        self,
        x: Tensor,
        edge_index: OptTensor = None,
        edge_attr: OptTensor = None,
        joint: OptTensor = None,
        absolute: OptTensor = None,
        pos: OptTensor = None,
        thread: Optional[str] = None,
    ) -> Tensor:
        r"""Returns the features of each taxel before the fully connected layers
        :math:`(B, N, F)`, of all threads side by side or of :obj:`thread` only.
        """
        if thread is not None and thread not in self.threads:
            raise ValueError(f"'thread' must be one of {self.inputs} (got '{thread}')")
        outs = []
        for name in self.inputs if thread is None else (thread,):
            h = self.collect(name, x, edge_index, edge_attr, absolute, pos)
            own = getattr(self, f"{name}_edge_index")
            edges = edge_index if own is None else own
            outs.append(self.convolve(self.threads[name], h, x, edges, own is not None))
        return outs[0] if len(outs) == 1 else torch.cat(outs, dim=-1)


def thread_specs(
    threads: Union[Mapping[str, Any], Sequence[str]], keys: Sequence[str]
) -> dict[str, dict[str, Any]]:
    r"""Returns the arguments of each thread, the paper's where nothing is said.

    Args:
        threads (dict or sequence of str): Of each input, what its thread has of its own.
        keys (sequence of str): What a thread may have of its own.

    Raises:
        ValueError: If a thread has something else.
    """
    given = threads if isinstance(threads, Mapping) else dict.fromkeys(threads)
    specs = {}
    for name, own in given.items():
        unknown = sorted(set(own or ()) - set(keys))
        if unknown:
            raise ValueError(
                f"a thread must have some of {list(keys)} (got '{unknown[0]}' in '{name}')"
            )
        specs[name] = {**(TACTILE_THREAD if name == "tactile" else OTHER_THREAD), **(own or {})}
    return specs
