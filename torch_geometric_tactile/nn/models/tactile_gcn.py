r"""A network with one thread of graph convolutions on the whole hand or on its segments."""

from collections.abc import Mapping, Sequence
from typing import Literal, Optional, Union

from torch import Tensor
from torch.nn import Module
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models._inputs import concatenate_inputs
from torch_geometric_tactile.nn.models._taxels import LayoutLike, load_layout
from torch_geometric_tactile.nn.models._thread_widths import POOLS, WIDTHS
from torch_geometric_tactile.nn.models.gcn_thread import GCNThread
from torch_geometric_tactile.nn.models.segmented_thread import SegmentedThread
from torch_geometric_tactile.nn.models.tactile_model import TactileModel
from torch_geometric_tactile.nn.models.thread import Thread


class TactileGCN(TactileModel):
    r"""The GCNs from the "Tactile Object Property Recognition using Geometrical Graph Edge Features
    and Multi-Thread Graph Convolutional Network" and "Multifingered Object Recognition with Tactile
    Sensors and Graph Convolutional Networks using Topological Graph Segmentation" papers (:doc:`P1
    and P2 </papers>`). They apply graph convolutions to the concatenated inputs of each taxel,
    followed by fully connected layers.

    * :obj:`segments=None` (the GCN in the first paper, model X in the second): one
      :class:`~torch_geometric_tactile.nn.models.GCNThread` on all taxels, "14, 28, 56(P)28,
      112(P)28, 112(P)7".
    * :obj:`segments="digit"` (model I): a
      :class:`~torch_geometric_tactile.nn.models.SegmentedThread` with separate weights for the palm
      and each digit (5 segments on the Allegro hand), "14, 56(P)7".
    * :obj:`segments="patch"` (model II): a
      :class:`~torch_geometric_tactile.nn.models.SegmentedThread` with separate weights for each
      patch (22 segments), "14, 56(P)7".

    The first paper uses the inputs :obj:`"tactile"` (T), :obj:`"edge"` (E) and :obj:`"absolute"`
    (A). The second paper uses :obj:`"tactile"` (Tac) and :obj:`"position"` (Pos). Both test all
    combinations, with and without joint angles.

    Args:
        layout (TaxelLayout, int, str or PathLike): The layout, the name of a stock layout, the path
            of a layout file, or the number of taxels. A layout is required if :obj:`segments` is
            set.
        out_channels (int): Number of labels or classes :math:`C`.
        segments (str, optional): :obj:`"digit"`, :obj:`"patch"` or :obj:`None`.
        inputs (sequence of str): Inputs to use: any of :obj:`"tactile"`, :obj:`"edge"`,
            :obj:`"absolute"` and :obj:`"position"`.
        num_edges (int, optional): Number of edges. Required by the dense encoder of :obj:`"edge"`.
        num_joints (int): Number of joint angles, 16 for an Allegro hand, or 0 for none.
        channels (dict, optional): Number of features per taxel by input, for inputs that differ
            from the default (3 or 4).
        encoder (str or torch.nn.Module): Encoder of edge features: :obj:`"dense"` (as in the
            paper), :obj:`"message"`, :obj:`"attention"` or a module.
        widths (sequence of int, optional): Width of each convolution. Defaults to the paper's.
        pools (sequence of int, optional): Pool size in channels after each convolution. Defaults to
            the paper's.
        head_widths (sequence of int): Width of each fully connected layer.
        head_pools (sequence of int): Pool size in channels after each fully connected layer.
        fast (bool): Whether to use a faster implementation for batches of at least eight samples on
            a CPU. It returns the same results, but does not support second derivatives.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`, edges :math:`(2, |\mathcal{E}|)` (edges between segments are
          ignored); further inputs as in
          :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If :obj:`segments` is unknown or :obj:`layout` does not define these segments,
            or if an input is unknown, is missing or has the wrong shape.

    Examples:
        >>> model = TactileGCN(inputs=("tactile", "edge"), num_edges=1401, num_joints=16)
        >>> model
        TactileGCN(384, 6, inputs=('tactile', 'edge'), num_joints=16)
        >>> model.head.in_channels
        2704
        >>> TactileGCN("allegro_uskin", 8, segments="patch").thread
        SegmentedThread(3, widths=(14, 56), pools=(1, 8), num_segments=22)
    """

    def __init__(
        self,
        layout: LayoutLike = "allegro_uskin",
        out_channels: int = 6,
        *,
        segments: Optional[Literal["digit", "patch"]] = None,
        inputs: Sequence[str] = ("tactile",),
        num_edges: Optional[int] = None,
        num_joints: int = 0,
        channels: Optional[Mapping[str, int]] = None,
        encoder: Union[str, Module] = "dense",
        widths: Optional[Sequence[int]] = None,
        pools: Optional[Sequence[int]] = None,
        head_widths: Sequence[int] = (1536, 384, 96),
        head_pools: Sequence[int] = (2, 2, 2),
        fast: bool = True,
    ) -> None:
        if segments not in (None, "digit", "patch"):
            raise ValueError(f"'segments' must be 'digit', 'patch' or None (got '{segments}')")
        segment: OptTensor = None
        if segments is not None:
            layout = load_layout(layout, f"segments='{segments}'")
            segment = layout.segments(segments)
        super().__init__(
            layout, out_channels, inputs=inputs, num_joints=num_joints, channels=channels
        )
        self.segments = segments
        self.add_encoder(encoder, num_edges)
        width = sum(self.channels[name] for name in self.inputs)
        if widths is None:
            widths = WIDTHS if segments is None else (14, 56)
        if pools is None:
            pools = POOLS if segments is None else (1, 8)
        self.thread: Thread
        if segment is None:
            self.thread = GCNThread(width, widths, pools, fast=fast)
        else:
            self.thread = SegmentedThread(width, segment, widths, pools, fast=fast)
        self.add_head(self.thread.out_channels, head_widths, head_pools)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the features of each taxel before the fully connected layers
        :math:`(B, N, F)`.
        """
        return self.convolve(self.thread, concatenate_inputs(parts), x, edge_index)

    def extra_repr(self) -> str:
        r"""Returns the sizes, inputs and segments for :obj:`repr`."""
        segments = "" if self.segments is None else f", segments='{self.segments}'"
        return f"{super().extra_repr()}{segments}"
