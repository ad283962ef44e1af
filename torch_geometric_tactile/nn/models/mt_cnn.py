r"""A network with a thread of convolutions on the image map of a hand for each input."""

from collections.abc import Mapping, Sequence
from typing import Any, Optional

from torch import Tensor
from torch.nn import ModuleDict
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models._inputs import concatenate_inputs
from torch_geometric_tactile.nn.models._taxel_image import checked_map
from torch_geometric_tactile.nn.models._taxels import LayoutLike, load_layout
from torch_geometric_tactile.nn.models._thread_widths import thread_settings
from torch_geometric_tactile.nn.models.cnn_thread import CNNThread
from torch_geometric_tactile.nn.models.tactile_model import TactileModel


class MTCNN(TactileModel):
    r"""The MT-CNN from the "Tactile Object Property Recognition using Geometrical Graph Edge
    Features and Multi-Thread Graph Convolutional Network" paper (:doc:`P1 </papers>`). For each
    input, it has a thread of convolutions on the image map of the hand, with the same widths as in
    :class:`~torch_geometric_tactile.nn.models.MTGCN`. The features of the threads are concatenated
    before the fully connected layers.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout or the path of
            a layout file. It must have an :obj:`image_map`.
        out_channels (int): Number of labels or classes :math:`C`.
        inputs (sequence of str): Inputs to use: any of :obj:`"tactile"`, :obj:`"absolute"` and
            :obj:`"position"`. Each input has a thread. The threads are concatenated in this order.
        threads (dict, optional): Settings of the threads by input, to override the paper's values.
            Each value is a dictionary with :obj:`widths`, :obj:`pools` or both.
        num_joints (int): Number of joint angles, 16 for an Allegro hand, or 0 for none.
        channels (dict, optional): Number of features per taxel by input, for inputs that differ
            from the default (3 or 4).
        head_widths (sequence of int): Width of each fully connected layer.
        head_pools (sequence of int): Pool size in channels after each fully connected layer.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`; further inputs as in
          :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If the layout has no image map, or an input is unknown, is missing or has the
            wrong shape.

    Examples:
        >>> MTCNN().head.in_channels
        5376
    """

    needs_edges = False

    def __init__(
        self,
        layout: LayoutLike = "allegro_uskin",
        out_channels: int = 6,
        *,
        inputs: Sequence[str] = ("tactile", "absolute"),
        threads: Optional[Mapping[str, Any]] = None,
        num_joints: int = 0,
        channels: Optional[Mapping[str, int]] = None,
        head_widths: Sequence[int] = (1536, 384, 96),
        head_pools: Sequence[int] = (2, 2, 2),
    ) -> None:
        settings = thread_settings(inputs, threads, ("widths", "pools"))
        layout = load_layout(layout, "its image map")
        super().__init__(
            layout, out_channels, inputs=inputs, num_joints=num_joints, channels=channels
        )
        image_map = checked_map(layout, self.inputs)
        self.threads, width = ModuleDict(), 0
        for name, thread_setting in settings.items():
            thread = CNNThread(
                self.channels[name], image_map, thread_setting["widths"], thread_setting["pools"]
            )
            self.threads[name] = thread
            width += thread.out_channels
        self.add_head(width, head_widths, head_pools)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the features of each taxel before the fully connected layers
        :math:`(B, N, F)`.
        """
        return concatenate_inputs(
            {name: self.threads[name](features) for name, features in parts.items()}
        )
