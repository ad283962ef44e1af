r"""Convolutions with bilinear features, for images of pressure."""

from typing import Literal, Optional, Union, get_args

import torch
from torch import Tensor
from torch.nn import BatchNorm2d, Conv2d, Linear
from torch.nn import functional as F
from torch.nn.init import xavier_uniform_, zeros_
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.nn._sizes import check_sizes
from torch_geometric_tactile.nn.conv._plain import is_hooked
from torch_geometric_tactile.nn.models._base_model import BaseModel
from torch_geometric_tactile.nn.models._taxel_image import TaxelImage
from torch_geometric_tactile.nn.models._taxels import load_layout, stacked_readings
from torch_geometric_tactile.nn.pool.bilinear_feature import BilinearFeature
from torch_geometric_tactile.sensors import TaxelLayout, letter_array

_Fusion = Literal["C3", "bilinear(C1)+C3", "C1+C3", "bilinear(C2)+C3", "C2+C3"]
_STRIPS = 7  # of the products, in an export; with more of them, cutting takes longer
_FUSIONS: tuple[str, ...] = get_args(_Fusion)
_BMF: _Fusion = "bilinear(C1)+C3"
LEAST_SIZE = 20  # of which C3 sees 3 x 3 cells


class BMFCNN(BaseModel):
    r"""The BMF-CNN of the "A Novel Bilinear Feature and Multi-Layer Fused Convolutional Neural
    Network for Tactile Shape Recognition" paper (:doc:`P5 </papers>`) for letters that are pressed
    on an array: three convolutions, and a fully connected layer on the features of the last one
    beside the :class:`~torch_geometric_tactile.nn.BilinearFeature` of the first.

    On 32 x 32 pixels, without zeros around them: C1, 5 x 5, 28 x 28 x 16, batch normalisation and
    ReLU; the maximum of 2 x 2 cells; C2, 3 x 3, 12 x 12 x 32, ReLU; the maximum; C3, 3 x 3, 4 x 4 x
    64 = 1024, ReLU; F-C1, 120, ReLU; F-C2, 26. The bilinear feature of C1, before its maximum, has
    28 x 28 x 16 = 12,544 numbers, so that F-C1 takes 13,568. What is fused is divided by its
    :math:`\ell_2` norm first, each layer by that of all its numbers.

    The paper does not say whether ReLU follows F-C1, nor which of Xavier's distributions it draws
    from: both are our choice (the uniform one). C1 has no bias, since batch normalisation follows.

    Args:
        layout (TaxelLayout, str or PathLike, optional): The layout, the name of a stock layout or
            the path of a layout file; its :obj:`image_map` must have at least 20 x 20 cells.
            :func:`~torch_geometric_tactile.sensors.letter_array` if left out. Cells without a taxel
            are zero.
        out_channels (int): Number of classes :math:`C`.
        in_channels (int): Features of each taxel :math:`F`.
        fusion (str): What F-C1 takes, one of the paper's Table 4: :obj:`"C3"`,
            :obj:`"bilinear(C1)+C3"`, :obj:`"C1+C3"`, :obj:`"bilinear(C2)+C3"` or :obj:`"C2+C3"`.
            C3 alone is not divided by its norm.
        bilinear (bool): If false, the paper's traditional CNN, which is :obj:`fusion="C3"`.
        hidden_channels (int): Width of F-C1.

    Shapes:
        - **input:** images :math:`(B, F, H, W)`, or readings :math:`(N, F)`, :math:`(B, N, F)` or
          those of a PyG batch :math:`(B \cdot N, F)`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If the layout has no map or a smaller one, the fusion is unknown or contradicts
            :obj:`bilinear`, a size is below one, or images or readings have another shape.

    Examples:
        >>> model = BMFCNN()
        >>> model
        BMFCNN(1024, 26, in_channels=1, fusion='bilinear(C1)+C3', size=(32, 32))
        >>> model(torch.zeros(2, 1, 32, 32)).shape
        torch.Size([2, 26])
        >>> model(torch.zeros(2, 1024, 1)).shape
        torch.Size([2, 26])
        >>> BMFCNN(bilinear=False).fc1
        Linear(in_features=1024, out_features=120, bias=True)
    """

    def __init__(
        self,
        layout: Optional[Union[TaxelLayout, PathLike]] = None,
        out_channels: int = 26,
        *,
        in_channels: int = 1,
        fusion: _Fusion = _BMF,
        bilinear: bool = True,
        hidden_channels: int = 120,
    ) -> None:
        super().__init__()
        layout = letter_array() if layout is None else load_layout(layout, "its image map")
        check_sizes(
            out_channels=out_channels, in_channels=in_channels, hidden_channels=hidden_channels
        )
        self.fusion = _checked_fusion(fusion, bilinear)
        self.num_nodes = layout.num_taxels
        self.in_channels = in_channels
        self.out_channels = out_channels
        self.image = TaxelImage(layout)
        if min(self.image.size) < LEAST_SIZE:
            raise ValueError(
                f"'layout' must have an image_map of at least {LEAST_SIZE} x {LEAST_SIZE} cells "
                f"(got {' x '.join(map(str, self.image.size))} in '{layout.name}')"
            )
        self.conv1 = Conv2d(in_channels, 16, 5, bias=False)
        self.norm1 = BatchNorm2d(16)
        self.conv2 = Conv2d(16, 32, 3)
        self.conv3 = Conv2d(32, 64, 3)
        self.bilinear_feature = BilinearFeature()
        self.fc1 = Linear(self._fused_channels(), hidden_channels)
        self.fc2 = Linear(hidden_channels, out_channels)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Draws all weights anew, as Xavier initialisation does, with biases of zero."""
        self.norm1.reset_parameters()
        for layer in (self.conv1, self.conv2, self.conv3, self.fc1, self.fc2):
            xavier_uniform_(layer.weight)
            if layer.bias is not None:
                zeros_(layer.bias)

    def _logits(self, x: Tensor, **unused: OptTensor) -> Tensor:
        return self.fc2(self._hidden(self._maps(x)))

    def features(self, x: Tensor) -> dict[str, Tensor]:
        r"""Returns the features of each layer by the name that the paper gives it, each after its
        ReLU and before the maximum of 2 x 2 cells: :obj:`"C1"`, :obj:`"bilinear(C1)"`,
        :obj:`"C2"`, :obj:`"bilinear(C2)"`, :obj:`"C3"` and :obj:`"F-C1"`. Bilinear features are
        there whatever is fused.

        Args:
            x (torch.Tensor): Images or readings.

        Shapes:
            - **output:** feature maps :math:`(B, F, H, W)`; of F-C1, :math:`(B, F)`
        """
        maps = self._maps(x)
        return {
            "C1": maps["C1"],
            "bilinear(C1)": self.bilinear_feature(maps["C1"]),
            "C2": maps["C2"],
            "bilinear(C2)": self.bilinear_feature(maps["C2"]),
            "C3": maps["C3"],
            "F-C1": self._hidden(maps),
        }

    def _maps(self, x: Tensor) -> dict[str, Tensor]:
        first = self.norm1(self.conv1(self._images(x))).relu()
        second = self.conv2(F.max_pool2d(first, 2)).relu()
        third = self.conv3(F.max_pool2d(second, 2)).relu()
        return {"C1": first, "C2": second, "C3": third}

    def _images(self, x: Tensor) -> Tensor:
        is_image = x.shape[-2:] == self.image.size and x.size(-1) != self.in_channels
        if x.dim() != 4 and not is_image:
            return self.image(stacked_readings(x, self.num_nodes, self.in_channels, "channels"))
        rows, columns = self.image.size
        if x.dim() != 4 or x.shape[1:] != (self.in_channels, rows, columns):
            raise ValueError(
                f"'x' must have shape (batch_size, {self.in_channels}, {rows}, {columns}) if it is "
                f"images (got {tuple(x.shape)})"
            )
        return x

    def _hidden(self, maps: dict[str, Tensor]) -> Tensor:
        low, _, high = self.fusion.rpartition("+")
        rows = maps[high].flatten(1)
        if not low:
            return self.fc1(rows).relu()
        rows = F.normalize(rows)
        if low in maps:
            return self.fc1(torch.cat([F.normalize(maps[low].flatten(1)), rows], dim=1)).relu()
        source = maps[low.removeprefix("bilinear(").removesuffix(")")]
        # The order: `torch.onnx` is not looked at where nothing is traced.
        if torch.compiler.is_compiling() and torch.onnx.is_in_onnx_export() and self._is_plain():
            return _linear_of_symmetric(self.fc1, self.bilinear_feature, source, rows).relu()
        feature = self.bilinear_feature(source)
        feature = feature / feature.size(1) ** 0.5  # each of its maps has norm one
        return self.fc1(torch.cat([feature.flatten(1), rows], dim=1)).relu()

    def _is_plain(self) -> bool:
        parts = ((self.fc1, Linear), (self.bilinear_feature, BilinearFeature))
        return all(type(part) is kind and not is_hooked(part) for part, kind in parts)

    def _fused_channels(self) -> int:
        rows, columns = self.image.size
        numbers = {}
        for name, width, kernel in (("C1", 16, 5), ("C2", 32, 3), ("C3", 64, 3)):
            rows, columns = rows - kernel + 1, columns - kernel + 1
            numbers[name] = width * rows * columns
            numbers[f"bilinear({name})"] = width * columns * columns
            rows, columns = rows // 2, columns // 2
        return sum(numbers[name] for name in self.fusion.split("+"))

    def extra_repr(self) -> str:
        r"""Returns the sizes and the fusion for :obj:`repr`."""
        return (
            f"{self.num_nodes}, {self.out_channels}, in_channels={self.in_channels}, "
            f"fusion='{self.fusion}', size={self.image.size}"
        )


def _linear_of_symmetric(
    lin: Linear, bilinear: BilinearFeature, source: Tensor, rows: Tensor
) -> Tensor:
    # As `lin` of all side by side, but of two equal products most are multiplied once, with the sum
    # of their weights. One image waits for the weights to come from memory: these are 4 of 7. What
    # is right of the diagonal is cut in strips, since gathering numbers takes longer than reading.
    # An ONNX runtime adds weights up once, when it loads the file; PyTorch would at each call.
    num_maps, width = source.size(1), source.size(-1)
    weight, others = lin.weight.tensor_split([num_maps * width * width], dim=1)
    weight = weight.view(-1, num_maps, width, width)
    mirrored = weight.mT
    phi = bilinear.products(source)
    height = -(-width // _STRIPS)
    products, weights, counts = [], [], []
    for start in range(0, width, height):
        stop = min(start + height, width)
        square = (..., slice(start, stop), slice(start, stop))
        right = (..., slice(start, stop), slice(stop, width))
        sums = torch.cat([weight[square], weight[right] + mirrored[right]], dim=-1)
        products.append(phi[..., start:stop, start:].flatten(2))
        weights.append(sums.flatten(2))
        count = phi.new_full((stop - start, width - start), 2.0)
        count[:, : stop - start] = 1.0
        counts.append(count.flatten())
    root = bilinear._signed_root(torch.cat(products, dim=2))  # (B, maps, products)
    norm = (root * root @ torch.cat(counts) * num_maps).sqrt()  # each map has norm one
    feature = (root / norm.unsqueeze(-1)).flatten(1)
    weight = torch.cat([torch.cat(weights, dim=2).flatten(1), others], dim=1)
    return F.linear(torch.cat([feature, rows], dim=1), weight, lin.bias)


def _checked_fusion(fusion: str, bilinear: bool) -> str:
    if fusion not in _FUSIONS:
        raise ValueError(f"'fusion' must be one of {_FUSIONS} (got {fusion!r})")
    if bilinear:
        return fusion
    if fusion not in ("C3", _BMF):  # the default is not a choice
        raise ValueError(f"'fusion' must be 'C3' if 'bilinear' is false (got '{fusion}')")
    return "C3"
