r"""Graph convolutional networks for grasp stability."""

from typing import Literal, Optional

import torch
from torch import Tensor
from torch.nn import Dropout1d, Linear, ModuleList
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.nn._sizes import check_sizes
from torch_geometric_tactile.nn.conv import StaticGCNConv
from torch_geometric_tactile.nn.models._base_model import BaseModel
from torch_geometric_tactile.nn.models._inputs import required_edges, with_joints
from torch_geometric_tactile.nn.models._taxels import LayoutLike, count_taxels


class GraspGCN(BaseModel):
    r"""The GCN-DF, GCN-FF and one-finger GCNs from the "Tactile Grasp Stability Classification
    Based on Graph Convolutional Networks" paper (:doc:`P3 </papers>`).

    These models have one graph convolution with ReLU on the electrodes, and one fully connected
    layer on all node features. All fingers share the same graph. The channels of :obj:`x` are
    ordered by finger: all channels of the first finger, then all channels of the second, and so on.

    * :obj:`fusion="data"` (GCN-DF): one convolution on the signals of all fingers.
    * :obj:`fusion="feature"` (GCN-FF): one convolution for each finger. The features of the fingers
      are concatenated.
    * :obj:`fusion=None` (GCN-L, -M, -R): one convolution on the signals of finger :obj:`finger`.

    The paper does not state the hidden width, or how the node features enter the fully connected
    layer. This implementation uses a width of 64 and flattens the node features. The outputs are
    logits. For two classes, their softmax equals the paper's sigmoid.

    Args:
        layout (TaxelLayout, int, str or PathLike): The layout of one finger, the name of a stock
            layout, the path of a layout file, or the number of electrodes :math:`N`.
        out_channels (int): Number of classes.
        in_channels (int): Number of channels of one finger at each electrode. For windows, this is
            the number of frames (60 in the paper).
        hidden_channels (int): Width of the graph convolution.
        num_fingers (int): Number of fingers :math:`K`.
        fusion (str, optional): :obj:`"data"`, :obj:`"feature"` or :obj:`None`.
        finger (int, optional): Index of the finger to use if :obj:`fusion` is :obj:`None`.
        num_layers (int): Number of graph convolutions (one in the paper).
        dropout (float): Probability of dropping all features of an electrode before the fully
            connected layer during training (zero in the paper).
        num_joints (int): Number of joint angles that are appended to the input of the fully
            connected layer. Other measurements from the hand can be used instead, such as forces
            and torques (suggested in the paper's outlook).
        fast (bool): Whether to propagate samples on one topology with a matrix product, as in
            :class:`~torch_geometric_tactile.nn.conv.StaticGCNConv`.

    Shapes:
        - **input:** readings :math:`(B, N, K \cdot F)` or, for a PyG batch,
          :math:`(B \cdot N, K \cdot F)`, edges :math:`(2, |\mathcal{E}|)`, optional edge weights
          :math:`(|\mathcal{E}|,)`, joint angles :math:`(B, J)`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If :obj:`fusion` is unknown, :obj:`finger` is missing, superfluous or out of
            range, a size is below one, or :obj:`x` has the wrong number of nodes or channels.

    Examples:
        >>> model = GraspGCN("biotac_sp", 2, fusion="data")
        >>> model
        GraspGCN(24, 2, in_channels=1, hidden_channels=64, num_fingers=3, fusion='data')
        >>> model(torch.zeros(5, 24, 3), torch.tensor([[0, 1], [1, 0]])).shape
        torch.Size([5, 2])
    """

    needs_edges = True

    def __init__(
        self,
        layout: LayoutLike = 24,
        out_channels: int = 2,
        *,
        in_channels: int = 1,
        hidden_channels: int = 64,
        num_fingers: int = 3,
        fusion: Optional[Literal["data", "feature"]] = "data",
        finger: Optional[int] = None,
        num_layers: int = 1,
        dropout: float = 0.0,
        num_joints: int = 0,
        fast: bool = True,
    ) -> None:
        super().__init__()
        self.num_nodes = count_taxels(layout)
        check_sizes(
            out_channels=out_channels,
            in_channels=in_channels,
            hidden_channels=hidden_channels,
            num_fingers=num_fingers,
            num_layers=num_layers,
        )
        need(
            fusion in ("data", "feature", None),
            "'fusion' must be 'data', 'feature' or None",
            f"'{fusion}'",
        )
        need(
            fusion is not None or (finger is not None and 0 <= finger < num_fingers),
            f"'finger' must be between 0 and {num_fingers - 1} if 'fusion' is None",
            finger,
        )
        need(fusion is None or finger is None, "'finger' must be None if 'fusion' is set", finger)
        need(num_joints >= 0, "'num_joints' must not be negative", num_joints)
        self.num_joints = num_joints
        self.in_channels = in_channels
        self.hidden_channels = hidden_channels
        self.out_channels = out_channels
        self.num_fingers = num_fingers
        self.fusion = fusion
        self.finger = finger
        num_threads = num_fingers if fusion == "feature" else 1
        input_width = in_channels * (num_fingers if fusion == "data" else 1)
        widths = [input_width] + [hidden_channels] * num_layers
        self.convs = ModuleList(
            ModuleList(
                StaticGCNConv(widths[i], widths[i + 1], fast=fast) for i in range(num_layers)
            )
            for _ in range(num_threads)
        )
        self.dropout = Dropout1d(dropout)
        width = self.num_nodes * hidden_channels * num_threads
        self.lin = Linear(width + num_joints, out_channels)

    def forward(
        self,
        x: Tensor,
        edge_index: OptTensor = None,
        edge_attr: OptTensor = None,
        joint: OptTensor = None,
        absolute: OptTensor = None,
        pos: OptTensor = None,
        *,
        edge_weight: OptTensor = None,
    ) -> Tensor:
        r"""Returns the logits of the classes.

        The arguments have the same order as in
        :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`.

        Args:
            x (torch.Tensor): Readings.
            edge_index (torch.Tensor): Edges.
            edge_attr, absolute, pos (torch.Tensor, optional): Not used.
            joint (torch.Tensor, optional): Joint angles in radians or other measurements from the
                hand :math:`(B, J)`. Required if :obj:`num_joints` is not 0.
            edge_weight (torch.Tensor, optional): Edge weights. Defaults to ones.
        """
        edge_index = required_edges(edge_index)
        # PyG's layers take weights as `edge_attr` or `edge_weight`. Ignoring them silently would
        # change the results.
        if edge_attr is not None and edge_attr.dim() == 1:
            raise ValueError(
                "'edge_attr' must be edge features, which this model does not use; pass edge "
                f"weights as 'edge_weight' (got shape {tuple(edge_attr.shape)})"
            )
        width = self.num_fingers * self.in_channels
        if x.dim() not in (2, 3) or x.size(-1) != width or x.size(-2) % self.num_nodes:
            raise ValueError(
                f"'x' must have {self.num_nodes} nodes and {width} channels "
                f"({self.num_fingers} fingers x {self.in_channels}) (got shape {tuple(x.shape)})"
            )
        if x.dim() == 3 and x.size(-2) != self.num_nodes:
            raise ValueError(f"'x' must have {self.num_nodes} nodes (got {x.size(-2)})")
        if self.fusion is None:
            assert self.finger is not None
            inputs = (x.narrow(-1, self.finger * self.in_channels, self.in_channels),)
        elif self.fusion == "data":
            inputs = (x,)
        else:
            inputs = x.split(self.in_channels, dim=-1)
        features = []
        for h, thread in zip(inputs, self.convs, strict=True):
            assert isinstance(thread, ModuleList)
            for conv in thread:
                h = conv(h, edge_index, edge_weight).relu_()
            features.append(h.reshape(-1, self.num_nodes * self.hidden_channels))
        node_features = features[0] if len(features) == 1 else torch.cat(features, dim=-1)
        if self.training and self.dropout.p > 0:
            unflattened = node_features.view(len(node_features), -1, self.hidden_channels)
            node_features = self.dropout(unflattened).flatten(1)
        return self.lin(with_joints(node_features, joint, self.num_joints))

    def extra_repr(self) -> str:
        r"""Returns the sizes and the fusion for :obj:`repr`."""
        finger = "" if self.finger is None else f", finger={self.finger}"
        layers = f", num_layers={len(self.convs[0])}" if len(self.convs[0]) > 1 else ""  # type: ignore[arg-type]
        joints = f", num_joints={self.num_joints}" if self.num_joints else ""
        return (
            f"{self.num_nodes}, {self.out_channels}, in_channels={self.in_channels}, "
            f"hidden_channels={self.hidden_channels}, num_fingers={self.num_fingers}, "
            f"fusion={self.fusion!r}{finger}{layers}{joints}"
        )
