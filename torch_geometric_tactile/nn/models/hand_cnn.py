r"""Convolutions on a map of the hand."""

from collections.abc import Mapping, Sequence
from typing import Any, Optional, Union

from torch import Tensor
from torch.nn import Conv2d, Module, ModuleDict, ModuleList
from torch_geometric.nn.inits import reset
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models.gcn_thread import POOLS, WIDTHS, checked_widths
from torch_geometric_tactile.nn.models.mt_gcn import thread_specs
from torch_geometric_tactile.nn.models.tactile_model import TactileModel, as_layout, side_by_side
from torch_geometric_tactile.sensors import TaxelLayout


class CNNThread(Module):
    r"""Convolutions on the map of a hand, with the widths and pools of a
    :class:`~torch_geometric_tactile.nn.models.GCNThread`: each is 3 x 3 with zeros around the map,
    the maximum over neighbouring channels, and ReLU. Cells without a taxel are zero in the input,
    and what the convolutions write there is not read in the end.

    Args:
        in_channels (int): Features of each taxel.
        image_map (torch.Tensor): Row and column of each taxel :math:`(N, 2)`.
        widths (sequence of int): Width of each convolution.
        pools (sequence of int): How many channels share one maximum, behind each convolution.

    Shapes:
        - **input:** features :math:`(B, N, F)`
        - **output:** features :math:`(B, N, F')`

    Raises:
        ValueError: If widths and pools do not fit each other, or :obj:`x` has other taxels or
            channels.
    """

    cell: Tensor

    def __init__(
        self,
        in_channels: int,
        image_map: Tensor,
        widths: Sequence[int] = WIDTHS,
        pools: Sequence[int] = POOLS,
    ) -> None:
        super().__init__()
        self.in_channels = in_channels
        self.widths, self.pool_sizes, sizes = checked_widths(in_channels, widths, pools)
        self.size = tuple((image_map.amax(dim=0) + 1).tolist())
        cell = image_map[:, 0] * self.size[1] + image_map[:, 1]
        self.register_buffer("cell", cell, persistent=False)
        self.out_channels = sizes[-1]
        self.convs = ModuleList(
            Conv2d(size, width, 3, padding="same")
            for size, width in zip(sizes, self.widths, strict=False)
        )

    def reset_parameters(self) -> None:
        r"""Draws all weights anew."""
        reset(self.convs)

    def forward(self, x: Tensor) -> Tensor:
        r"""Convolves the features of the taxels.

        Args:
            x (torch.Tensor): Features.
        """
        if x.dim() != 3 or x.size(1) != len(self.cell) or x.size(2) != self.in_channels:
            raise ValueError(
                f"'x' must have shape (batch_size, {len(self.cell)}, {self.in_channels}) "
                f"(got {tuple(x.shape)})"
            )
        rows, columns = self.size
        image = x.new_zeros(x.size(0), x.size(2), rows * columns)
        image = image.index_copy(2, self.cell, x.transpose(1, 2)).unflatten(2, (rows, columns))
        for conv, pool in zip(self.convs, self.pool_sizes, strict=True):
            image = conv(image)
            if pool > 1:
                image = image.unflatten(1, (-1, pool)).amax(dim=2)
            image = image.relu()
        return image.flatten(2)[:, :, self.cell].transpose(1, 2)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.in_channels}, widths={self.widths}, "
            f"pools={self.pool_sizes}, size={self.size})"
        )


class HandCNN(TactileModel):
    r"""The CNN of the "Tactile Object Property Recognition using Geometrical Graph Edge Features
    and Multi-Thread Graph Convolutional Network" paper: the inputs of the taxels on a map of the
    hand, convolutions with the widths of the GCN, and fully connected layers.

    The paper's map is not given. Ours is that of the layout, where patches lie as on the hand, with
    empty cells between them. The taxels' cells are read back behind the last convolution, which
    gives the paper's :math:`384 \cdot 7` features.

    Args:
        layout (TaxelLayout or str): The taxels, with an :obj:`image_map`, or the name of a layout
            that comes with the package.
        out_channels (int): Number of labels or classes :math:`C`.
        inputs (sequence of str): Some of :obj:`"tactile"`, :obj:`"absolute"` and
            :obj:`"position"`.
        num_joints (int): Number of joint angles; 16 for an Allegro hand, 0 for none.
        widths (sequence of int): Width of each convolution.
        pools (sequence of int): How many channels share one maximum, behind each convolution.
        head_widths (sequence of int): Width of each fully connected layer.
        head_pools (sequence of int): How many channels share one maximum, behind each of them.
        channels (dict, optional): Features of a taxel by input, where they are not 3 or 4.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch
          :math:`(B \cdot N, F)`; further inputs as
          :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward` says
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If the layout has no map, or an input is unknown, missing or of another shape.

    Examples:
        >>> model = HandCNN(inputs=("tactile", "absolute"))
        >>> model.threads["all"]
        CNNThread(7, widths=(14, 28, 56, 112, 112), pools=(1, 1, 2, 4, 16), size=(32, 16))
        >>> model.head.in_channels
        2688
    """

    def __init__(
        self,
        layout: Union[TaxelLayout, str] = "allegro_uskin",
        out_channels: int = 6,
        inputs: Sequence[str] = ("tactile",),
        num_joints: int = 0,
        widths: Sequence[int] = WIDTHS,
        pools: Sequence[int] = POOLS,
        head_widths: Sequence[int] = (1536, 384, 96),
        head_pools: Sequence[int] = (2, 2, 2),
        channels: Optional[dict[str, int]] = None,
    ) -> None:
        layout = as_layout(layout)
        super().__init__(layout.num_taxels, out_channels, inputs, num_joints, channels)
        image_map = checked_map(layout, self.inputs)
        width = sum(self.channels[name] for name in self.inputs)
        thread = CNNThread(width, image_map, widths, pools)
        self.threads = ModuleDict({"all": thread})
        self.add_head(thread.out_channels, head_widths, head_pools)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the features of each taxel before the fully connected layers."""
        if "all" in self.threads:
            return self.threads["all"](side_by_side(parts))
        return side_by_side({name: self.threads[name](part) for name, part in parts.items()})


class MTCNN(HandCNN):
    r"""The MT-CNN of the "Tactile Object Property Recognition using Geometrical Graph Edge Features
    and Multi-Thread Graph Convolutional Network" paper: a thread of convolutions on the map of the
    hand for each input, with the widths of :class:`~torch_geometric_tactile.nn.models.MTGCN`.

    Args:
        layout (TaxelLayout or str): The taxels, with an :obj:`image_map`, or the name of a layout
            that comes with the package.
        out_channels (int): Number of labels or classes :math:`C`.
        threads (dict or sequence of str): For each input, the :obj:`widths` and :obj:`pools` of its
            thread, where they are not the paper's.
        num_joints (int): Number of joint angles; 16 for an Allegro hand, 0 for none.
        head_widths (sequence of int): Width of each fully connected layer.
        head_pools (sequence of int): How many channels share one maximum, behind each of them.
        channels (dict, optional): Features of a taxel by input, where they are not 3 or 4.

    Shapes:
        - **input:** as :class:`HandCNN`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If the layout has no map, or an input is unknown, missing or of another shape.

    Examples:
        >>> MTCNN().head.in_channels
        5376
    """

    def __init__(
        self,
        layout: Union[TaxelLayout, str] = "allegro_uskin",
        out_channels: int = 6,
        threads: Union[Mapping[str, Any], Sequence[str]] = ("tactile", "absolute"),
        num_joints: int = 0,
        head_widths: Sequence[int] = (1536, 384, 96),
        head_pools: Sequence[int] = (2, 2, 2),
        channels: Optional[dict[str, int]] = None,
    ) -> None:
        specs = thread_specs(threads, ("widths", "pools"))
        layout = as_layout(layout)
        TactileModel.__init__(
            self, layout.num_taxels, out_channels, tuple(specs), num_joints, channels
        )
        image_map = checked_map(layout, self.inputs)
        threads = {
            name: CNNThread(self.channels[name], image_map, spec["widths"], spec["pools"])
            for name, spec in specs.items()
        }
        self.threads = ModuleDict(threads)
        width = sum(thread.out_channels for thread in threads.values())
        self.add_head(width, head_widths, head_pools)


def checked_map(layout: TaxelLayout, inputs: Sequence[str]) -> Tensor:
    r"""Returns row and column of each taxel on the map of a hand :math:`(N, 2)`.

    Args:
        layout (TaxelLayout): The taxels.
        inputs (sequence of str): The inputs of the model, none of which may be on edges.

    Raises:
        ValueError: If there is no map, or an input is on edges.
    """
    if "edge" in inputs:
        raise ValueError(f"'inputs' must not have 'edge': there is no graph (got {inputs})")
    if layout.image_map is None:
        raise ValueError(f"'layout' must have an image_map (got none in '{layout.name}')")
    return layout.image_map
